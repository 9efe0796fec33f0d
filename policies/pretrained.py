"""Policies that come with the package, loaded by name.

A policy file is a pickle, and a pickle runs code. Shipped files are therefore read once, compared with the SHA-256 in
`weights/manifest.json`, and unpickled from those same bytes. A path of your own is not in the manifest: naming it means
trusting it.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from policies.train.checkpoints import MODEL_FILE, NORMALISATION_FILE
from stair_env.common.extras import naming_extras

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

WEIGHTS_FOLDER = Path(__file__).parent / "weights"
MANIFEST_FILE = "manifest.json"
CARD_FILE = "card.json"


class PolicyError(ValueError):
    """A policy cannot be loaded or does not fit; the message says why and what would."""


class Policy:
    """A trained policy with its normalisation: observation in, action out.

    Attributes:
        name: shipped name, or the folder it came from.
        card: how it was trained and how well it does.
        observation_space, action_space: what it was trained on.
    """

    def __init__(self, name: str, model: BaseAlgorithm, normalisation: Any, card: Mapping[str, Any]) -> None:
        self.name = name
        self.card = dict(card)
        self._model = model
        self._normalisation = normalisation
        self.observation_space: gym.Space = model.observation_space
        self.action_space: gym.Space = model.action_space

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Action for one observation or a batch of them, as the environment gives them (not normalised).

        Args:
            observation: an observation of `observation_space`, with or without a leading batch axis.
            state, episode_start: as in SB3; unused by policies without memory.
            deterministic: the most likely action instead of a drawn one.

        Returns:
            (action float32, state), as SB3's `predict`.
        """
        if self._normalisation is not None:
            observation = self._normalisation.normalize_obs(observation)
        return self._model.predict(observation, state, episode_start, deterministic)

    def check_spaces(self, env: gym.Env) -> None:
        """Refuse an environment that the policy was not trained on.

        Raises:
            PolicyError: naming the space and both sides of the difference.
        """
        for kind in ("observation_space", "action_space"):
            trained, given = getattr(self, kind), getattr(env, kind)
            difference = describe_difference(trained, given)
            if difference:
                raise PolicyError(f"policy {self.name!r} does not fit the environment: {kind} {difference}")


def names() -> tuple[str, ...]:
    """Names of the shipped policies."""
    return tuple(sorted(_manifest(WEIGHTS_FOLDER)))


def locate(policy: str | Path, weights: Path = WEIGHTS_FOLDER) -> Path:
    """Folder of a policy by shipped name or path; a shipped one's files are checked against the manifest.

    Args:
        policy: a name, a folder with `model.zip`, a `.zip` file, or the folder of an rl_zoo3 run.
        weights: folder of shipped policies.

    Raises:
        PolicyError: no such policy, or a shipped file was changed.
    """
    if str(policy) in _manifest(weights):
        _read_checked(str(policy), weights)
        return weights / str(policy)
    return _own_files(policy, weights)[MODEL_FILE].parent


def _own_files(policy: str | Path, weights: Path) -> dict[str, Path]:
    """Files of a policy that is not a shipped one, by the names that shipped ones have.

    rl_zoo3 leaves `ENV.zip` in the run's folder and `vecnormalize.pkl` in its subfolder `ENV`.
    """
    path = Path(policy)
    models = [path] if path.suffix == ".zip" else [path / MODEL_FILE, *sorted(path.glob(f"*/{NORMALISATION_FILE}"))]
    for model in models:
        if model.name == NORMALISATION_FILE:
            model = model.parent.with_name(f"{model.parent.name}.zip")
        if model.is_file():
            files = {MODEL_FILE: model}
            for beside in (model.with_suffix("") / NORMALISATION_FILE, model.with_name(NORMALISATION_FILE)):
                if beside.is_file():
                    files[NORMALISATION_FILE] = beside
            return files
    choices = ", ".join(sorted(_manifest(weights))) or "none shipped yet"
    raise PolicyError(
        f"policy={str(policy)!r} is neither a shipped name ({choices}) nor a folder with {MODEL_FILE}, a .zip file, "
        "or the folder of an rl_zoo3 run"
    )


@naming_extras()
def load(policy: str | Path, env: gym.Env | None = None, weights: Path = WEIGHTS_FOLDER) -> Policy:
    """Load a policy.

    Args:
        policy: a shipped name (see `names`), a folder with `model.zip`, a `.zip` file beside `vecnormalize.pkl`, or the
            folder of an rl_zoo3 run.
        env: environment whose spaces must match.
        weights: folder of shipped policies.

    Raises:
        PolicyError: unknown name, changed file, or spaces that do not match.
    """
    folder = locate(policy, weights)
    if str(policy) in _manifest(weights):
        contents = _read_checked(str(policy), weights)
    else:
        contents = {name: path.read_bytes() for name, path in _own_files(policy, weights).items()}
    card_file = folder / CARD_FILE
    card = json.loads(card_file.read_text(encoding="utf-8")) if card_file.is_file() else {}
    loaded = _unpickle(str(policy), contents, card)
    if env is not None:
        loaded.check_spaces(env)
    return loaded


def add(folder: Path | str, name: str, weights: Path = WEIGHTS_FOLDER, evaluations: Sequence[Path] = ()) -> Path:
    """Put a trained policy among the shipped ones: files, hashes in the manifest, model card.

    Args:
        folder: a run's `final/` folder or one of its checkpoints.
        name: name to ship it under.
        weights: folder of shipped policies.
        evaluations: JSON files of `stair-env evaluate` for the model card.

    Raises:
        PolicyError: the folder holds no policy.
    """
    from policies.train.cards import run_card, write_card
    from stair_env.common.files import atomic_path

    source = locate(folder, weights)
    target = weights / name
    target.mkdir(parents=True, exist_ok=True)
    hashes = {}
    for file, path in _own_files(folder if Path(folder).suffix == ".zip" else source, weights).items():
        content = path.read_bytes()
        (target / file).write_bytes(content)
        hashes[file] = hashlib.sha256(content).hexdigest()
    card, curve = run_card(source)
    (target / CARD_FILE).write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    manifest = {**_manifest(weights), name: hashes}
    with atomic_path(weights / MANIFEST_FILE) as temporary:
        temporary.write_text(json.dumps(manifest, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    write_card(target, name, card, curve, evaluations)
    return target


def describe_difference(trained: gym.Space, given: gym.Space) -> str:
    """In words, how two spaces differ; "" when a policy for one works on the other."""
    if isinstance(trained, gym.spaces.Dict) and isinstance(given, gym.spaces.Dict):
        if set(trained.spaces) != set(given.spaces):
            return f"has keys {sorted(given.spaces)}, the policy was trained on {sorted(trained.spaces)}"
        parts = ((key, describe_difference(space, given.spaces[key])) for key, space in trained.spaces.items())
        return next((f"[{key!r}] {text}" for key, text in parts if text), "")
    if type(trained) is not type(given) or trained.shape != given.shape or trained.dtype != given.dtype:
        return f"is {_brief(given)}, the policy was trained on {_brief(trained)}"
    if isinstance(trained, gym.spaces.Box) and isinstance(given, gym.spaces.Box) and trained != given:
        return "has other bounds than the policy was trained on"
    return ""


def _brief(space: gym.Space) -> str:
    return f"{type(space).__name__} of shape {space.shape}, {space.dtype}"


def _manifest(weights: Path) -> dict[str, dict[str, str]]:
    """Name -> file -> SHA-256; empty where nothing is shipped."""
    path = weights / MANIFEST_FILE
    if not path.is_file():
        return {}
    manifest: dict[str, dict[str, str]] = json.loads(path.read_text(encoding="utf-8"))
    return manifest


def _read_checked(name: str, weights: Path) -> dict[str, bytes]:
    """The bytes of a shipped policy's files, each equal to its hash in the manifest."""
    contents = {}
    for file, expected in _manifest(weights)[name].items():
        path = weights / name / file
        if not path.is_file():
            raise PolicyError(f"policy {name!r}: {file} is missing; install the package again")
        contents[file] = path.read_bytes()
        found = hashlib.sha256(contents[file]).hexdigest()
        if found != expected:
            raise PolicyError(
                f"policy {name!r}: {file} has SHA-256 {found[:12]}..., expected {expected[:12]}...; it was changed "
                "or cut short and is not loaded"
            )
    return contents


def _unpickle(name: str, contents: Mapping[str, bytes], card: Mapping[str, Any]) -> Policy:
    from policies.train.training import algorithm_class

    try:
        model = algorithm_class(card.get("algorithm", "ppo")).load(io.BytesIO(contents[MODEL_FILE]), device="cpu")
    except (KeyError, ValueError, EOFError, pickle.UnpicklingError, OSError) as error:
        raise PolicyError(f"policy {name!r}: {MODEL_FILE} is no Stable-Baselines3 model: {error}") from None
    normalisation = None
    if NORMALISATION_FILE in contents:
        normalisation = pickle.loads(contents[NORMALISATION_FILE])
        normalisation.training = False
        normalisation.norm_reward = False
    return Policy(name, model, normalisation, card)


def _main() -> None:
    """`python -m policies.pretrained RUN/final NAME [EVALUATION.json ...]` ships a policy."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m policies.pretrained", description=add.__doc__)
    parser.add_argument("folder")
    parser.add_argument("name")
    parser.add_argument("evaluations", nargs="*", type=Path)
    args = parser.parse_args()
    print(add(args.folder, args.name, evaluations=args.evaluations))


if __name__ == "__main__":
    _main()
