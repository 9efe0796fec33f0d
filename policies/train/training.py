"""Training with Stable-Baselines3: PPO and SAC, checkpointed and resumable.

A run's folder holds `config.json` (what was asked), `checkpoints/` (see `policies.train.checkpoints`), `curve.csv` (one
row an interval), `tensorboard/`, `wandb/` and `flights/` when asked for, and at the end `final/` (model, normalisation,
card).
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from policies.hyperparams import ALGORITHMS, load_hyperparams
from policies.make_env import CLIMB_ID, PERCEPTION_ID, make_vec_env, normalise
from policies.saved_models import read_pickle
from policies.train import checkpoints
from policies.train.curves import CURVE_FILE
from policies.train.described import described, described_objects
from policies.train.wandb_run import wandb_run
from stair_env.common.field_kinds import naming_fields
from stair_env.common.files import provenance, read_json_object, write_json
from stair_env.common.validation import check_choice
from stair_env.observation import PRIVILEGED_KEY

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv

LOGGER = logging.getLogger(__name__)

CONFIG_FILE = "config.json"
CARD_FILE = "card.json"
FINAL_FOLDER = "final"
CHECKPOINT_FOLDER = "checkpoints"
FLIGHT_FOLDER = "flights"
# Keys of the YAML file that others read.
RLLIB_KEY = "rllib"  # settings of RLlib alone
NOT_THE_ALGORITHMS = ("n_timesteps", "n_envs", "normalize", "callback", "env_kwargs", RLLIB_KEY)
TRAINING_ENGINES = ("local", "rllib")
HIDING_POLICIES = ("StairActorCriticPolicy", "StairSacPolicy", "StairTd3Policy", "StairTqcPolicy")
DEFAULT_GAMMA = 0.99  # of both algorithms in SB3


@dataclass(frozen=True)
class TrainingConfig:
    """What a run trains.

    Args:
        algorithm: "ppo" or "sac".
        env_id: environment id.
        env_kwargs: keyword arguments of the environment, on top of those of the YAML file; of parts that are objects,
            files only tell which they were.
        hyperparams: values that replace those of the algorithm's YAML file.
        hyperparams_file: YAML file in place of the shipped one.
        total_timesteps: environment steps over all environments; None takes the file's n_timesteps.
        num_envs: parallel environments; None takes the file's n_envs.
        seed: seed of environments, networks and exploration.
        vec_kind: "auto", "subproc", "dummy" or "workers" (`policies.make_env.make_vec_env`).
        checkpoint_every: environment steps between checkpoints.
        tensorboard: write TensorBoard logs.
        wandb: project of Weights & Biases that gets what TensorBoard gets; None for none. `WANDB_MODE=offline` keeps it
            on this machine.
        torch_threads: threads of the network's updates.
        rerun: with each checkpoint fly the policy, and write a recording for the Rerun viewer.
        engine: "local" (Stable-Baselines3, here) or "rllib" (`policies.train.rllib`).
        workers: environment runners of RLlib.
        ray_address: of a running Ray cluster; None starts one on this machine.
        network_server: with RLlib, the cameras of all environments ask one network.

    Raises:
        ValueError: a value is out of range.
    """

    algorithm: str = "ppo"
    env_id: str = CLIMB_ID
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    hyperparams: Mapping[str, Any] = field(default_factory=dict)
    hyperparams_file: str | None = None
    total_timesteps: int | None = None
    num_envs: int | None = None
    seed: int = 0
    vec_kind: str = "auto"
    checkpoint_every: int = 50_000
    tensorboard: bool = False
    wandb: str | None = None
    torch_threads: int = 1
    rerun: bool = False
    engine: str = "local"
    workers: int = 1
    ray_address: str | None = None
    network_server: bool = False

    @naming_fields
    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise ValueError(f"algorithm={self.algorithm!r} must be one of {', '.join(ALGORITHMS)}")
        check_choice("engine", self.engine, TRAINING_ENGINES)
        for name in ("total_timesteps", "num_envs", "checkpoint_every", "torch_threads", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}={value!r} must be >= 1")

        if self.network_server and (self.engine, self.env_id) != ("rllib", PERCEPTION_ID):
            raise ValueError(f"network_server=True is for engine='rllib' and {PERCEPTION_ID}")
        if self.ray_address is not None and self.engine != "rllib":
            raise ValueError(f"ray_address={self.ray_address!r} is for engine='rllib', not {self.engine!r}")

    def resolved_hyperparams(self) -> dict[str, Any]:
        """The YAML file's values with this configuration's on top."""
        values = load_hyperparams(self.algorithm, self.env_id, self.hyperparams_file) | dict(self.hyperparams)
        if self.total_timesteps is not None:
            values["n_timesteps"] = self.total_timesteps
        if self.num_envs is not None:
            values["n_envs"] = self.num_envs
        return values

    def resolved_env_kwargs(self) -> dict[str, Any]:
        """The YAML file's arguments of the environment, with this configuration's on top."""
        file = load_hyperparams(self.algorithm, self.env_id, self.hyperparams_file)
        return {**file.get("env_kwargs", {}), **self.env_kwargs}

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form; `TrainingConfig(**values)` rebuilds it, unless parts of the environment are objects."""
        return {entry.name: described(getattr(self, entry.name)) for entry in dataclasses.fields(self)}


def train(
    config: TrainingConfig,
    folder: Path | str,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    show_progress: bool = False,
) -> dict[str, Any]:
    """Train a policy.

    Args:
        config: what to train.
        folder: the run's folder, made if missing.
        resume: go on from the newest checkpoint in the folder (from the start when there is none yet).
        start_from: folder of a saved policy whose weights and statistics the run begins with (fine-tuning).
        show_progress: draw a progress bar on stderr.

    Returns:
        The card of the result, as `final/card.json` holds it.

    Raises:
        ValueError: the folder holds another run and resume is False, or a wrong argument.
    """
    import torch

    from policies.train.callbacks import CheckpointCallback, CurveCallback, ProgressCallback

    folder = Path(folder)
    if (folder / CONFIG_FILE).exists() and not resume:
        raise ValueError(f"{folder} already holds a run: resume it or choose another folder")
    flights = _flights(config, folder)
    torch.set_num_threads(config.torch_threads)
    hyperparams = config.resolved_hyperparams()
    total = int(hyperparams["n_timesteps"])
    saved = checkpoints.list_checkpoints(folder / CHECKPOINT_FOLDER) if resume else []
    env_kwargs = config.resolved_env_kwargs()
    venv = make_vec_env(config.env_id, int(hyperparams["n_envs"]), env_kwargs, seed=config.seed, kind=config.vec_kind)
    with contextlib.ExitStack() as opened:
        opened.callback(venv.close)
        write_json(folder / CONFIG_FILE, config.to_dict(), seed=config.seed)  # only now: wrong arguments leave no run
        if saved:
            model = _load_model(config, hyperparams, venv, saved[-1])
        else:
            model = _new_model(config, hyperparams, venv, start_from)
        logs = folder / "tensorboard" if config.tensorboard or config.wandb else None
        opened.enter_context(wandb_run(config.wandb, folder, config.to_dict()))  # before TensorBoard's writer
        _set_logging(model, logs)
        curve = CurveCallback(folder / CURVE_FILE)
        callbacks = [CheckpointCallback(folder / CHECKPOINT_FOLDER, config.checkpoint_every), curve, *flights]
        if show_progress:
            callbacks.append(ProgressCallback(total))
        remaining = total - model.num_timesteps
        if remaining > 0:
            model.learn(remaining, callback=callbacks, reset_num_timesteps=not saved, log_interval=1)
        return _finish(config, model, folder, curve.summary())


def _flights(config: TrainingConfig, folder: Path) -> list[Any]:
    """The callback that writes flights, when they were asked for."""
    if not config.rerun:
        return []
    from policies.train.flight_callback import RerunCallback

    return [RerunCallback(folder / FLIGHT_FOLDER, config)]


def load_config(folder: Path | str) -> TrainingConfig:
    """The configuration of a run's folder.

    Raises:
        FileNotFoundError: the folder holds no run.
        ValueError: the run's environment has parts that are objects, which no file brings back.
    """
    values = read_json_object(Path(folder) / CONFIG_FILE)
    objects = described_objects(values.get("env_kwargs"))
    if objects:
        raise ValueError(
            f"the run in {folder} has parts that are objects ({', '.join(objects)}): go on from Python, with "
            "policies.train.training.train(config, folder, resume=True)"
        )
    names = {item.name for item in dataclasses.fields(TrainingConfig)}
    return TrainingConfig(**{name: value for name, value in values.items() if name in names})


def algorithm_class(algorithm: str) -> type[BaseAlgorithm]:
    """SB3's class of an algorithm's name."""
    import stable_baselines3

    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm={algorithm!r} must be one of {', '.join(ALGORITHMS)}")
    found: type[BaseAlgorithm] = getattr(stable_baselines3, algorithm.upper())
    return found


def _split(hyperparams: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """The algorithm's own arguments, and the value of `normalize` (False, True or VecNormalize's arguments)."""
    values = {name: value for name, value in hyperparams.items() if name not in NOT_THE_ALGORITHMS}
    policy = values.get("policy", "MultiInputPolicy")
    if "." in policy:
        module, _, name = policy.rpartition(".")
        values["policy"] = getattr(importlib.import_module(module), name)
    rate = values.get("learning_rate")
    if isinstance(rate, str):
        values["learning_rate"] = _schedule(rate)
    return values, hyperparams.get("normalize", False)


def _schedule(text: str) -> Any:
    """`lin_3e-4` falls linearly to zero over the run, as in rl_zoo3."""
    from stable_baselines3.common.utils import LinearSchedule

    kind, _, value = text.partition("_")
    if kind != "lin":
        raise ValueError(f"learning_rate={text!r} must be a number or lin_NUMBER")
    return LinearSchedule(float(value), 0.0, 1.0)


def build_model(config: TrainingConfig, hyperparams: Mapping[str, Any], venv: VecEnv) -> BaseAlgorithm:
    """A fresh model on environments as they are.

    Args:
        config: names the algorithm and the seed.
        hyperparams: as `TrainingConfig.resolved_hyperparams` gives them.
        venv: normalised already, if it shall be.

    Raises:
        ValueError: the actor would read what no robot knows.
    """
    arguments, _ = _split(hyperparams)
    _check_privileged(venv, arguments.get("policy"))
    return algorithm_class(config.algorithm)(env=venv, seed=config.seed, device="cpu", **arguments)


def _new_model(
    config: TrainingConfig, hyperparams: Mapping[str, Any], venv: VecEnv, start_from: Path | None
) -> BaseAlgorithm:
    normalisation = _split(hyperparams)[1]
    if start_from is not None and (start_from / checkpoints.NORMALISATION_FILE).exists():
        statistics = read_pickle((start_from / checkpoints.NORMALISATION_FILE).read_bytes())  # may be foreign
        statistics.set_venv(venv)
        statistics.training = True
        venv = statistics
    elif normalisation:
        options = normalisation if isinstance(normalisation, dict) else {}
        venv = normalise(venv, gamma=float(hyperparams.get("gamma", DEFAULT_GAMMA)), options=options)
    model = build_model(config, hyperparams, venv)
    if start_from is not None:
        model.set_parameters(str(start_from / checkpoints.MODEL_FILE), exact_match=False, device="cpu")
    return model


def _check_privileged(venv: VecEnv, policy: Any) -> None:
    """Refuse a policy whose actor would read what no robot knows.

    Raises:
        ValueError: the observation has a privileged block, and the policy is none that hides it.
    """
    spaces = getattr(venv.observation_space, "spaces", {})
    hides = any(base.__name__ in HIDING_POLICIES for base in getattr(policy, "__mro__", ()))
    if PRIVILEGED_KEY in spaces and not hides:
        raise ValueError(
            f"policy={policy!r} would let the actor read the privileged block; choose policies.features."
            f"{' or '.join(HIDING_POLICIES)}"
        )


def _load_model(
    config: TrainingConfig, hyperparams: Mapping[str, Any], venv: VecEnv, checkpoint: Path
) -> BaseAlgorithm:
    """The model of a checkpoint with statistics, curriculum, replay buffer and random state as they were."""
    from stable_baselines3.common.vec_env import VecNormalize

    LOGGER.info("resuming from %s", checkpoint)
    bare = venv
    with checkpoints.naming_damage(checkpoint):
        state = checkpoints.read_state(checkpoint)
        if (checkpoint / checkpoints.NORMALISATION_FILE).exists():
            venv = VecNormalize.load(str(checkpoint / checkpoints.NORMALISATION_FILE), venv)
        model = algorithm_class(config.algorithm).load(checkpoint / checkpoints.MODEL_FILE, env=venv, device="cpu")
        if (checkpoint / checkpoints.REPLAY_FILE).exists():
            model.load_replay_buffer(checkpoint / checkpoints.REPLAY_FILE)  # type: ignore[attr-defined]
        checkpoints.restore_random_state(checkpoint)
    # The episodes that the kill cut off are gone: new ones, seeded by where the run stands.
    bare.seed(int(np.random.SeedSequence([config.seed, state["num_timesteps"]]).generate_state(1)[0] >> 1))
    checkpoints.restore_curriculum(bare, state["curriculum"])
    return model


def _set_logging(model: BaseAlgorithm, folder: Path | None) -> None:
    """TensorBoard into the folder, or nothing: SB3's own default leaves an empty folder in /tmp for each run."""
    from stable_baselines3.common.logger import Logger

    if folder is None:
        model.set_logger(Logger(None, []))
    else:
        model.tensorboard_log = str(folder)


def _finish(config: TrainingConfig, model: BaseAlgorithm, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
    """Write `final/`: the policy and its card."""
    final = folder / FINAL_FOLDER
    checkpoints.save_policy(model, final)
    card = {
        "algorithm": config.algorithm,
        "env_id": config.env_id,
        "env_kwargs": described(config.resolved_env_kwargs()),
        "hyperparams": config.resolved_hyperparams(),
        "timesteps": model.num_timesteps,
        "training": summary,
        "curriculum": checkpoints.curriculum_states(model.get_env()),
        **provenance(config.seed),
    }
    write_json(final / CARD_FILE, card, seed=config.seed)
    return card
