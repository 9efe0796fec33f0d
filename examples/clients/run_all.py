"""Run every recipe of this folder, and write the versions into a file: `python examples/clients/run_all.py [FILE]`."""

import re
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
BASE = ("gymnasium", "numpy", "stable-baselines3", "torch")
TIMEOUT_S = 1200


def version_of(name: str) -> str:
    try:
        return f"{name} {metadata.version(name)}"
    except metadata.PackageNotFoundError:
        return f"{name} missing"


def main() -> int:
    failed, lines = [], []
    for script in sorted(FOLDER.glob("*.py")):
        if script.name == Path(__file__).name:
            continue
        names = re.findall(r"^[A-Za-z0-9_-]+", script.with_suffix(".txt").read_text(), re.MULTILINE)
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as place:
            done = subprocess.run([sys.executable, str(script)], cwd=place, timeout=TIMEOUT_S, check=False)
        seconds = time.monotonic() - begun
        result = "runs" if done.returncode == 0 else f"fails ({done.returncode})"
        print(f"{script.name}: {result}, {seconds:.0f} s", flush=True)
        lines.append(f"| `{script.name}` | {', '.join(map(version_of, names)) or 'PyTorch alone'} | {result} |")
        if done.returncode:
            failed.append(script.name)
    base = ", ".join(map(version_of, BASE))
    text = [
        "# Clients",
        "",
        f"Written by `examples/clients/run_all.py` (`make test-clients`): Python {sys.version.split()[0]}, {base}.",
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
