import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.constants import BLOCK_SOURCES
from stair_env.common.validation import SpecError
from stair_env.observation import STAIR_HIGH, STAIR_LOW, StairBlock
from stair_env.stairs import StairSpec
from stair_env.task.sources import VIEW_RANGE_M, ExternalSource, HipPose, make_source, true_block

SPEC = StairSpec(riser_height=0.12, tread_depth=0.28, num_steps=4)
PROFILE = SPEC.profile()


def read(source, pose):
    return source.read(pose, true_block(SPEC, PROFILE, pose))


@given(st.floats(-3, 3), st.floats(-1, 1), st.sampled_from(["up", "down"]))
def test_truth_points_at_the_next_edge(x, yaw, direction):
    spec = StairSpec(direction=direction, riser_height=0.12, tread_depth=0.28, num_steps=4)
    profile = spec.profile()
    block = true_block(spec, profile, HipPose(x, yaw, 0.0))
    ahead = profile.edge_x[profile.edge_x > x]
    if not len(ahead) or ahead[0] - x > VIEW_RANGE_M:
        assert block.valid == 0.0
        return
    assert x + block.edge_distance == pytest.approx(ahead[0])
    assert block.direction == (1.0 if direction == "up" else -1.0)
    assert (block.step_width, block.step_height) == pytest.approx((0.28, 0.12))
    assert block.heading_error == pytest.approx(-yaw)


def test_uneven_steps_are_told_one_by_one():
    spec = StairSpec(num_steps=3, riser_offsets=(0.01, -0.01, 0.0), tread_offsets=(0.02, 0.0, 0.0))
    profile = spec.profile()
    heights = [true_block(spec, profile, HipPose(x, 0, 0)).step_height for x in profile.edge_x - 0.1]
    widths = [true_block(spec, profile, HipPose(x, 0, 0)).step_width for x in profile.edge_x - 0.1]
    assert heights == pytest.approx([0.16, 0.14, 0.15])
    assert widths == pytest.approx([0.32, 0.30, 0.30])  # behind the last nosing lies the landing


@pytest.mark.parametrize("name", sorted(BLOCK_SOURCES))
def test_blocks_lie_in_the_space_and_repeat_with_the_seed(name):
    def rollout():
        source = make_source(name)
        source.reset(SPEC, np.random.default_rng(3))
        return np.array([read(source, HipPose(-1 + 0.007 * k, 0.02, k / 48)).as_array() for k in range(300)])

    blocks = rollout()
    assert (blocks >= STAIR_LOW).all() and (blocks <= STAIR_HIGH).all() and np.isfinite(blocks).all()
    assert np.array_equal(blocks, rollout())
    assert not blocks[blocks[:, 0] == 0].any()


def test_blind_never_sees_and_shuffled_sees_other_stairs():
    blind, shuffled = make_source("blind"), make_source("shuffled")
    for seed in range(20):
        blind.reset(SPEC, np.random.default_rng(seed))
        shuffled.reset(SPEC, np.random.default_rng(seed))
        pose = HipPose(-0.5, 0.0, 0.0)
        assert read(blind, pose).valid == 0.0
        told = read(shuffled, pose)
        assert abs(told.step_height - 0.12) >= 0.03 and abs(told.step_width - 0.28) >= 0.04


def test_noisy_is_near_the_truth():
    source = make_source("noisy")
    errors = []
    for seed in range(40):
        source.reset(SPEC, np.random.default_rng(seed))
        for k in range(40):
            pose = HipPose(-0.8, 0.0, k / 48)
            told, truth = read(source, pose), true_block(SPEC, PROFILE, pose)
            if told.valid:
                errors.append([told.step_width - truth.step_width, told.edge_distance - truth.edge_distance])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms > 0.002).all() and (rms < 0.03).all()


def test_external_hands_out_what_it_is_given():
    source = make_source("external")
    assert isinstance(source, ExternalSource)
    source.reset(SPEC, np.random.default_rng(0))
    assert read(source, HipPose(0, 0, 0)).valid == 0.0
    source.provide(StairBlock(1.0, 1.0, 0.3, 0.1, 0.5, 0.0, 0.0, 1.0))
    assert read(source, HipPose(0, 0, 0)).edge_distance == 0.5


def test_unknown_source_names_the_choices():
    with pytest.raises(SpecError, match="oracle"):
        make_source("psychic")
