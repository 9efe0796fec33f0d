"""Parts of one's own, given as objects: under gym.make, in worker processes and in Stable-Baselines3's."""

import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest

import stair_env.parts
from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.observation import NO_STAIRS
from stair_env.parts import ROBOTS, Gait, GaitConfig, Randomization, RewardTerm, SceneSampler, SceneSpec, StairSpec
from stair_env.rgbd import StairClimbRgbdEnv

PLAIN, PERCEPTION = "stair_env/StairClimb-v0", "stair_env/StairClimbPerception-v0"


class LateSource:
    """Tells nothing for a second, then the truth; counts its reads, so that sharing would show."""

    def reset(self, spec, rng):
        self.reads = 0

    def read(self, pose, truth):
        self.reads += 1
        return truth if pose.time_s > 0.2 else NO_STAIRS


def energy(state):
    return -state.joint_power_w * state.dt_s


def rollout(env, steps=20):
    env.reset(seed=4)
    return [float(env.step(np.zeros(env.action_space.shape))[1]) for _ in range(steps)]


def test_everything_named_is_there():
    assert all(hasattr(stair_env.parts, name) for name in stair_env.parts.__all__)


def test_an_object_that_equals_a_name_changes_nothing():
    named = rollout(StairClimbEnv(robot="a1", randomization=True))
    objects = StairClimbEnv(
        robot=ROBOTS["a1"], gait=Gait(ROBOTS["a1"]), randomization=Randomization(), rewards={"progress": 1.0}
    )
    assert rollout(objects) == named


def test_a_source_of_ones_own_fills_the_block_and_is_not_shared():
    source = LateSource()
    envs = [StairClimbEnv(stair_source=source) for _ in range(2)]
    for env in envs:
        rollout(env)
        assert env.source.reads == 21 and env.state.block == env.state.truth
    assert not hasattr(source, "reads")


def test_a_scene_of_ones_own_is_what_robot_and_camera_meet():
    sampler = SceneSampler(direction="up_down", num_steps=3, lighting="night", details=False)
    plain, camera = StairClimbEnv(sampler=sampler), StairClimbRgbdEnv(sampler=sampler, camera={"width": 160})
    for env in (plain, camera):
        env.reset(seed=7)
    assert plain.stairs == camera.stairs and plain.stairs.direction == "up_down"
    assert camera.scene.spec.appearance.lighting == "night" and camera.scene.spec.stairs is camera.stairs
    assert np.array_equal(plain.state.after.position, camera.state.after.position)
    given = StairSpec(num_steps=2)
    assert plain.reset(seed=7, options={"stairs": given})[1]["truth"]["num_steps"] == 2
    plain.close()
    camera.close()


class Draws:
    def __init__(self, drawn):
        self.drawn = drawn

    def sample(self, rng):
        return self.drawn


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": 3}, "robot=3.*RobotSpec.*aliengo"),
        ({"robot": dataclasses.replace(ROBOTS["a1"], urdf="none.urdf")}, "urdf='none.urdf' of robot 'a1'"),
        ({"gait": "gallop"}, "gait='gallop'.*trot"),
        ({"gait": GaitConfig(), "actuation": "joint"}, "gait.*actuation"),
        ({"stair_source": 3}, "stair_source=3.*oracle.*read"),
        ({"stair_source": LateSource}, "stair_source"),
        ({"sampler": 3}, "sampler=3.*sample"),
        ({"sampler": SceneSampler(), "curriculum": True}, "sampler.*curriculum"),
        ({"rewards": {"progress": "a lot"}}, "rewards.*progress.*a lot"),
        ({"terminations": {"fall": 1}}, "terminations.*fall.*1"),
        ({"observations": {"rgb": None}}, "observations.*rgb.*stair"),
    ],
)
def test_wrong_parts_are_named(arguments, message):
    with pytest.raises(SpecError, match=message):
        StairClimbEnv(**arguments)


@pytest.mark.parametrize("drawn", [None, SceneSpec(None)])
def test_a_sampler_must_draw_stairs(drawn):
    env = StairClimbEnv(sampler=Draws(drawn))
    with pytest.raises(SpecError, match=r"sampler=.*StairSpec"):
        env.reset(seed=0)
    env.close()


@pytest.mark.parametrize("field", ["joint_names", "toe_names"])
def test_a_urdf_without_the_named_parts_is_told(field):
    names = getattr(ROBOTS["a1"], field)
    env = StairClimbEnv(robot=dataclasses.replace(ROBOTS["a1"], **{field: ("tail", *names[1:])}))
    with pytest.raises(SpecError, match=f"{field} of robot 'a1'='tail'.*{names[0]}"):
        env.reset(seed=0)
    env.close()


def test_a_broken_urdf_is_told(tmp_path):
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot/>")
    env = StairClimbEnv(robot=dataclasses.replace(ROBOTS["a1"], urdf=str(broken)))
    with pytest.raises(SpecError, match=r"broken\.urdf"):
        env.reset(seed=0)
    env.close()


def test_names_stay_json_and_environments_with_objects_pickle():
    rewards = {"nosing": None, "progress": 2.0}
    env = gym.make(PLAIN, robot="a1", gait="trot", rewards=rewards, terminations={"left_flight": None})
    twin = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert rollout(twin) == rollout(env)
    objects = StairClimbEnv(robot=ROBOTS["a1"], rewards={"energy": RewardTerm(energy)}, gait=GaitConfig(flat_speed=0.3))
    assert rollout(pickle.loads(pickle.dumps(objects))) == rollout(objects)


def test_the_perception_id_takes_them_too():
    rewards = {"e": RewardTerm(energy)}
    env = gym.make(PERCEPTION, camera={"width": 160}, gait=GaitConfig(flat_speed=0.3), rewards=rewards)
    env.reset(seed=0)
    *_, info = env.step(np.zeros(16, np.float32))
    env.close()
    assert "e" in info["reward_terms"]


def test_functions_without_a_name_reach_workers():
    """Nothing that plain pickle can send: cloudpickle brings it to the workers, and back again."""
    scale = 3.0

    def own(state):
        return scale

    vector = gym.make_vec(PLAIN, 2, rewards={"own": RewardTerm(own)}, gait=lambda robot: Gait(robot), context="spawn")
    vector.reset(seed=0)
    *_, infos = vector.step(np.zeros((2, 16), np.float32))
    assert infos["reward_terms"]["own"].tolist() == [3.0, 3.0]
    assert [found.terms["own"].fn.fn(None) for found in vector.get_attr("rewards")] == [3.0, 3.0]
    vector.close()
