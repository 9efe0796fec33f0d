"""Policies that come with the package, loaded by name.

Shipped files are read once, compared with the SHA-256 in `weights/manifest.json`, and loaded from those same bytes.
Nothing in a file is run, be it foreign (`policies.saved_models`): a policy with classes of your own needs trusted=True.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies.joint_level.mirror import act_both_ways, check_mirrors
from policies.joint_level.remembering import Recall, remembers, without_memory
from policies.make_env import ENV_IDS
from policies.portable import portable
from policies.rollout import CONTROLS
from policies.saved_models import SavedModel, SavedModelError, algorithm_in_arguments, read_model, read_pickle
from policies.spaces import describe_difference, flatten
from policies.train.checkpoints import MODEL_FILE, NORMALISATION_FILE
from stair_env.common.files import read_json_object
from stair_env.common.importing.extras import naming_extras
from stair_env.robots import DEFAULT_ROBOT, get_robot

WEIGHTS_FOLDER = Path(__file__).parent / "weights"
HUB_NORMALISATION_FILE = "vec_normalize.pkl"  # what the Hugging Face hub calls NORMALISATION_FILE
MANIFEST_FILE = "manifest.json"
CARD_FILE = "card.json"
ARGUMENTS_FILE, BEST_FILE = "args.yml", "best_model.zip"  # of rl_zoo3's runs
# What decides which robot acts, and what observation and action hold.
INTERFACE = ("robot", "actuation", "actuator", "observations", "command", "gait", "privileged")


class PolicyError(ValueError):
    """A policy cannot be loaded or does not fit; the message says why and what would."""


class Policy:
    """A trained policy with its normalisation: observation in, action out.

    Attributes:
        name: shipped name, or the folder it came from.
        card: how it was trained and how well it does; with `symmetric` it acts by
            `policies.joint_level.mirror.act_both_ways`.
        algorithm: that trained it, a name in `policies.saved_models.ALGORITHMS`.
        model, normalisation: of Stable-Baselines3; no normalisation is None.
        observation_space, action_space: what it was trained on.
    """

    def __init__(self, name: str, model: SavedModel, normalisation: Any, card: Mapping[str, Any]) -> None:
        self.name = name
        self.card = dict(card)
        self.algorithm, self.model = model
        self.normalisation = normalisation
        self._flattened: gym.spaces.Dict | None = None  # what the environment gives, to a policy that reads one vector
        self.observation_space: gym.Space = self.model.observation_space
        self.action_space: gym.Space = self.model.action_space
        self._recall = Recall(card) if remembers(self.observation_space) else None
        self._symmetric = bool(card.get("symmetric", False))
        if self._symmetric:
            try:
                check_mirrors(self.observation_space, self.action_space)
            except ValueError as error:
                raise PolicyError(f"policy {name!r} is symmetric by its card: {error}") from None

    @property
    def _model(self) -> Any:
        """What `model` was called before it was public; scripts that look in still find it."""
        return self.model

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Action for one observation or a batch of them, as the environment gives them (not normalised).

        Args:
            observation: an observation of `observation_space`, with or without a leading batch axis.
            state, episode_start: as in SB3; unused by policies without memory. Hand the returned state to the next
                call of the same episode; None begins one.
            deterministic: the most likely action instead of a drawn one.

        Returns:
            (action float32, state), as SB3's `predict`.
        """
        if self._flattened is not None:
            observation = flatten(self._flattened, observation)
        if self._recall is not None and not remembers(observation):
            observation, state = self._recall.add(observation, state, episode_start)
        if self._symmetric:
            act = lambda seen: self.model.predict(self._normalised(seen), None, None, deterministic)[0]  # noqa: E731
            return act_both_ways(act, observation), state
        return self.model.predict(self._normalised(observation), state, episode_start, deterministic)

    def _normalised(self, observation: Any) -> Any:
        return observation if self.normalisation is None else self.normalisation.normalize_obs(observation)

    def check_spaces(self, env: gym.Env) -> None:
        """Refuse an environment that the policy was not trained on.

        A policy that remembers (`policies.joint_level.remembering`) brings its memory along where the environment has
        none. One that was trained on `gymnasium.wrappers.FlattenObservation` fits the environment without it, too.

        Raises:
            PolicyError: naming the space and both sides of the difference.
        """
        whole = env.observation_space
        if isinstance(whole, gym.spaces.Dict) and isinstance(self.observation_space, gym.spaces.Box):
            self._flattened = whole if self.observation_space == gym.spaces.flatten_space(whole) else None
        for kind in ("observation_space", "action_space"):
            trained, given = getattr(self, kind), getattr(env, kind)
            if given is self._flattened and self._flattened is not None:
                continue
            if kind == "observation_space" and self._recall is not None and not remembers(given):
                trained = without_memory(trained)
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


def read_files(policy: str | Path, weights: Path = WEIGHTS_FOLDER) -> dict[str, bytes]:
    """Contents of a policy's files: `model.zip`, and where it has them `vecnormalize.pkl` and rl_zoo3's `args.yml`.

    Args:
        policy: as in `load`.
        weights: folder of shipped policies.

    Raises:
        PolicyError: no such policy, or a shipped file was changed.
    """
    if str(policy) in _manifest(weights):
        return _read_checked(str(policy), weights)
    return {name: path.read_bytes() for name, path in _own_files(policy, weights).items()}


def _own_files(policy: str | Path, weights: Path) -> dict[str, Path]:
    """Files of a policy that is not a shipped one, by the names that shipped ones have.

    rl_zoo3 leaves `ENV.zip` in the run's folder (before its end only `best_model.zip` and `rl_model_N_steps.zip`), and
    `args.yml`, `config.yml` and `vecnormalize.pkl` in its subfolder `ENV`.
    """
    path = Path(policy)
    if path.suffix == ".zip":
        models = [path]
    else:
        zoo = sorted({file.parent for name in (ARGUMENTS_FILE, NORMALISATION_FILE) for file in path.glob(f"*/{name}")})
        models = [path / MODEL_FILE, *(folder.with_name(f"{folder.name}.zip") for folder in zoo), path / BEST_FILE]
    for model in models:
        if model.is_file():
            return {MODEL_FILE: model, **_files_beside(model)}
    choices = ", ".join(sorted(_manifest(weights))) or "none shipped yet"
    raise PolicyError(
        f"policy={str(policy)!r} is neither a shipped name ({choices}) nor a folder with {MODEL_FILE}, a .zip file, "
        "or the folder of an rl_zoo3 run"
    )


def _files_beside(model: Path) -> dict[str, Path]:
    """Statistics and arguments that belong to a model's zip."""
    own, folders = model.with_suffix(""), [path for path in sorted(model.parent.glob("*/")) if path.is_dir()]
    steps = re.fullmatch(r"(.+)_(\d+)_steps", model.stem)  # as SB3's CheckpointCallback names them
    found = {}
    for name in (NORMALISATION_FILE, ARGUMENTS_FILE):
        places = [own / name, model.with_name(name)]
        if steps and name == NORMALISATION_FILE:
            places.insert(0, model.with_name(f"{steps[1]}_vecnormalize_{steps[2]}_steps.pkl"))
        if name == NORMALISATION_FILE:
            places.append(model.with_name(HUB_NORMALISATION_FILE))
        if model.name == BEST_FILE or steps:
            places += [folder / name for folder in folders]
        for place in places:
            if place.is_file():
                found[name] = place
                break
    return found


def interface(policy: str | Path, weights: Path = WEIGHTS_FOLDER) -> dict[str, Any]:
    """Arguments of `gym.make` without which a policy does not fit, as its card tells; empty where there is no card.

    They are those of INTERFACE that it was trained with, and always the robot.
    """
    card = read_card(policy, weights)
    if card.get("env_id") not in ENV_IDS:
        return {}
    trained = {name: value for name, value in card.get("env_kwargs", {}).items() if name in INTERFACE}
    return {"robot": DEFAULT_ROBOT, **trained}


def fitting_robot(robot: str | None, policies: Iterable[str | Path | None] = (), weights: Path = WEIGHTS_FOLDER) -> str:
    """The robot that policies were trained on.

    Args:
        robot: name of the wanted one; None takes the policies', or DEFAULT_ROBOT where they tell nothing.
        policies: names or paths; None stands for no policy.
        weights: folder of shipped policies.

    Raises:
        PolicyError: a policy was trained on another robot; the message names both, and policies that would do.
        SpecError: no such robot.
    """
    for policy in policies:
        trained = interface(policy, weights).get("robot") if policy is not None else None
        if trained is None:
            continue
        robot = trained if robot is None else robot
        if robot != trained:
            get_robot(robot)
            fitting = [name for name in sorted(_manifest(weights)) if interface(name, weights).get("robot") == robot]
            raise PolicyError(
                f"robot={robot!r}: policy {str(policy)!r} was trained on {trained!r}; leave the robot out, or use a "
                f"policy of {robot!r}: {', '.join(fitting) or 'none shipped yet'}"
            )
    return get_robot(DEFAULT_ROBOT if robot is None else robot).name


def read_card(policy: str | Path, weights: Path = WEIGHTS_FOLDER) -> dict[str, Any]:
    """How a policy was trained; empty where there is no such policy, or it has no card."""
    from policies.train.cards import run_card

    if policy in CONTROLS:
        return {}
    try:
        folder = locate(policy, weights)
    except PolicyError:
        return {}
    return _card_in(folder) or run_card(folder)[0]


def _card_in(folder: Path) -> dict[str, Any]:
    """The card in a folder, empty where there is none; a damaged one is a PolicyError."""
    return _read_object(folder / CARD_FILE) if (folder / CARD_FILE).is_file() else {}


def _read_object(file: Path) -> dict[str, Any]:
    try:
        return read_json_object(file)
    except ValueError as error:
        raise PolicyError(str(error)) from None


@naming_extras()
def load(
    policy: str | Path, env: gym.Env | None = None, weights: Path = WEIGHTS_FOLDER, *, trusted: bool = False
) -> Policy:
    """Load a policy.

    Args:
        policy: a shipped name (see `names`), a folder with `model.zip`, a `.zip` file beside `vecnormalize.pkl`, or the
            folder of an rl_zoo3 run.
        env: environment whose spaces must match.
        weights: folder of shipped policies.
        trusted: let the file name anything, such as a feature extractor of your own, and so run code.

    Raises:
        PolicyError: unknown name, changed, damaged or foreign file, unknown algorithm, or spaces that do not match.
    """
    folder, contents = locate(policy, weights), read_files(policy, weights)
    loaded = _rebuild(str(policy), contents, _card_in(folder), trusted)
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
        if file == ARGUMENTS_FILE:
            continue
        content = portable(file, path.read_bytes())
        with atomic_path(target / file) as temporary:
            temporary.write_bytes(content)
        hashes[file] = hashlib.sha256(content).hexdigest()
    card, curve = run_card(source)
    with atomic_path(target / CARD_FILE) as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    manifest = {**_manifest(weights), name: hashes}
    with atomic_path(weights / MANIFEST_FILE) as temporary:
        temporary.write_text(json.dumps(manifest, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    write_card(target, name, card, curve, evaluations)
    return target


def _manifest(weights: Path) -> dict[str, dict[str, str]]:
    """Name -> file -> SHA-256; empty where nothing is shipped."""
    path = weights / MANIFEST_FILE
    if not path.is_file():
        return {}
    return _read_object(path)


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


def _rebuild(name: str, contents: Mapping[str, bytes], card: Mapping[str, Any], trusted: bool) -> Policy:
    arguments = contents.get(ARGUMENTS_FILE, b"").decode("utf-8", "replace")
    algorithm = card.get("algorithm") or algorithm_in_arguments(arguments)
    file = MODEL_FILE
    try:
        model = read_model(contents[file], algorithm, trusted=trusted)
        normalisation = None
        if NORMALISATION_FILE in contents:
            file = NORMALISATION_FILE
            read = pickle.loads if trusted else read_pickle
            normalisation = read(contents[file])
            normalisation.training = normalisation.norm_reward = False
    except (SavedModelError, AttributeError) as error:
        raise PolicyError(f"policy {name!r}: {file} is no Stable-Baselines3 model: {error}") from None
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
