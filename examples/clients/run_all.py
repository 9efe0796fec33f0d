"""Run every recipe of this folder, and write the versions into a file: `python examples/clients/run_all.py [FILE]`.

A recipe whose library does not get along with the others is run by the interpreter of `.venv-clients-NAME`, if there is
one beside `.venv-clients`.
"""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
BASE = ("gymnasium", "numpy", "stable-baselines3", "torch")
TIMEOUT_S = 1200
ASK = """
import sys
from importlib import metadata
for name in sys.argv[1:]:
    try:
        print(name, metadata.version(name))
    except metadata.PackageNotFoundError:
        print(name, "missing")
"""


def interpreter(recipe: str) -> str:
    own = Path(f"{sys.prefix}-{recipe.partition('_')[0]}") / "bin" / "python"
    return str(own) if own.exists() else sys.executable


def versions(python: str, names: list[str]) -> str:
    asked = subprocess.run([python, "-c", ASK, *names], capture_output=True, text=True, check=True)
    return ", ".join(asked.stdout.splitlines())


def main() -> int:
    failed, lines = [], []
    for script in sorted(FOLDER.glob("*.py")):
        if script.name == Path(__file__).name:
            continue
        files = [script.with_suffix(suffix) for suffix in (".no-deps", ".txt")]
        asked = "".join(file.read_text(encoding="utf-8") for file in files if file.exists())
        python, names = interpreter(script.stem), re.findall(r"^[A-Za-z0-9_-]+", asked, re.MULTILINE)
        if python != sys.executable:
            names += ["gymnasium"]
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as place:
            try:
                code = subprocess.run(
                    [python, "-W", "ignore", str(script)], cwd=place, timeout=TIMEOUT_S, check=False
                ).returncode
            except subprocess.TimeoutExpired:
                code = None
        seconds = time.monotonic() - begun
        result = "runs" if code == 0 else f"not done after {TIMEOUT_S} s" if code is None else f"fails ({code})"
        print(f"{script.name}: {result}, {seconds:.0f} s", flush=True)
        lines.append(f"| `{script.name}` | {versions(python, names) or 'PyTorch alone'} | {result} |")
        if code != 0:
            failed.append(script.name)
    text = [
        "# Clients",
        "",
        f"Written by `examples/clients/run_all.py` (`make test-clients`): Python {sys.version.split()[0]}, "
        f"{versions(sys.executable, list(BASE))}; where a row names another Gymnasium, in an environment of its own.",
        "",
        "| recipe in examples/clients | with | result |",
        "|---|---|---|",
        *lines,
    ]
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text("\n".join(text) + "\n", encoding="utf-8")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
