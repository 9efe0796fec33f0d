import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.task.step_state import NO_COMMAND
from stair_env.task.terms.commands import CommandConfig, Commands, command_space, pack_command, read_command


def test_commands_lie_in_their_ranges_and_stay_for_the_episode():
    commands = Commands(CommandConfig(forward=(0.2, 0.6), lateral=0.1, turn=(-0.5, 0.5)))
    drawn = [commands.reset(np.random.default_rng(seed)) for seed in range(50)]
    assert all(0.2 <= c.forward <= 0.6 and c.lateral == 0.1 and abs(c.turn) <= 0.5 for c in drawn)
    assert len({c.forward for c in drawn}) == 50
    assert commands.at(100.0) == drawn[-1]


def test_commands_change_after_their_interval():
    commands = Commands(CommandConfig(interval_s=2.0))
    first = commands.reset(np.random.default_rng(0))
    assert commands.at(1.9) == first != commands.at(2.0) == commands.at(3.9) != commands.at(4.0)


def test_ways_to_write_one():
    assert read_command(None).config is None and read_command(False).config is None
    assert read_command(True).config == CommandConfig()
    assert read_command(0.4).config.forward == (0.4, 0.4) and read_command([0.2, 0.4]).config.forward == (0.2, 0.4)
    assert read_command({"turn": 0.2}).config.turn == (0.2, 0.2)
    assert read_command(None).reset(np.random.default_rng(0)) == NO_COMMAND


def test_the_observation_holds_it(make_state):
    env = StairClimbEnv(command={"forward": [0.2, 0.5], "turn": 0.1})
    observation, _ = env.reset(seed=0)
    env.close()
    assert env.observation_space.contains(observation) and observation["command"].shape == (3,)
    assert tuple(observation["command"]) == pytest.approx(tuple(env.state.command))
    assert command_space().contains(pack_command(make_state()))


@pytest.mark.parametrize("command", ["fast", 9.0, [0.4, 0.2], {"speed": 1.0}, {"interval_s": -1}])
def test_wrong_commands_are_named(command):
    with pytest.raises(SpecError, match="command"):
        StairClimbEnv(command=command)
