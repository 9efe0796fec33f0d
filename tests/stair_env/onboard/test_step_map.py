import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.step_map import LOST_AFTER_S, StepMap

DT = 1 / 48
HIP = 0.24


def block(distance, direction=1.0, width=0.3, height=0.15):
    return StairBlock(1.0, direction, width, height, distance, 0.0, 0.0, 1.0)


def walk(step_map, start, metres, edges, direction=1.0):
    """Walk past edges (positions ahead of the hips at the start), observing each control step."""
    for travelled in np.arange(0.0, metres, 0.01):
        ahead = [edge - travelled for edge in edges if edge - travelled > 0]
        step_map.advance(0.01 if travelled else 0.0, DT)
        step_map.observe(block(ahead[0], direction) if ahead else NO_STAIRS, HIP)


def test_edges_are_remembered_after_the_hips_have_passed():
    step_map = StepMap()
    walk(step_map, 0, 0.7, edges=[0.2, 0.5])
    s, rise = zip(*step_map.edges())
    assert s == pytest.approx([HIP + 0.2 - 0.69, HIP + 0.5 - 0.69], abs=1e-6)
    assert rise == pytest.approx([0.15, 0.15])
    assert not step_map.has_edge_ahead


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("travelled", [0.35, 0.65, 0.95])
def test_height_counts_the_edges(travelled, direction):
    step_map, edges = StepMap(), [0.2, 0.5, 0.8]
    walk(step_map, 0, travelled, edges, direction)
    behind = sum(edge + HIP < travelled for edge in edges)
    assert step_map.heights_at(np.array([0.0, -1.4])) == pytest.approx([direction * 0.15 * behind, 0.0])


def test_a_correction_shifts_the_whole_map():
    step_map = StepMap()
    walk(step_map, 0, 0.3, edges=[0.2, 0.5])
    before = [s for s, _ in step_map.edges()]
    step_map.observe(block(before[1] - HIP + 0.03), HIP)
    after = [s for s, _ in step_map.edges()]
    assert after[:2] == pytest.approx([s + 0.03 for s in before[:2]])


def test_an_edge_nobody_confirms_is_dropped():
    step_map = StepMap()
    step_map.observe(block(1.0), HIP)
    for _ in range(int(LOST_AFTER_S / DT) + 2):
        step_map.advance(0.0, DT)
        step_map.observe(NO_STAIRS, HIP)
    assert not step_map.knows_stairs


def test_start_on_the_flight_fills_in_the_edges_between_the_feet():
    step_map = StepMap()
    step_map.observe(block(0.1), HIP)
    step_map.assume_on_flight(height_difference=0.31)
    s = [s for s, _ in step_map.edges()]
    assert s[:3] == pytest.approx([HIP + 0.1 - 0.6, HIP + 0.1 - 0.3, HIP + 0.1])
    assert step_map.heights_at(np.array([0.2]))[0] == pytest.approx(0.0)
    assert step_map.heights_at(np.array([-0.4]))[0] == pytest.approx(-0.30)


@given(st.floats(-0.5, 1.5), st.sampled_from([1.0, -1.0]), st.booleans(), st.floats(-0.03, 0.03))
def test_footholds_keep_their_distance_and_their_tread(s, direction, choosing, correction):
    step_map = StepMap()
    step_map.observe(block(0.3, direction), HIP)
    margins = {"before": 0.05, "after": 0.05, "after_drop": 0.09}
    placed = step_map.clear_of_edges(s, **margins, choosing=choosing)
    for edge, rise in step_map.edges():
        assert placed <= edge - 0.05 + 1e-9 or placed >= edge + (0.05 if rise > 0 else 0.09) - 1e-9
    # never further than the margins ask; half of both where the tread is free to choose
    assert abs(placed - s) <= (0.0701 if choosing else 0.0901)
    # A correction of the map moves the foothold with its tread, it never jumps to another.
    step_map.observe(block(0.3 + correction, direction), HIP)
    assert abs(step_map.clear_of_edges(placed, **margins) - placed) <= abs(correction) + 1e-9


@given(true_share=st.floats(0.86, 1.04), speed=st.floats(0.2, 0.5))
def test_slip_is_learned_from_the_edge_that_comes_nearer_and_used_when_none_does(true_share, speed):
    step_map, dt = StepMap(), 1 / 48
    hip, edge = 0.24, 1.2
    walked = 0.0
    while edge - walked > hip + 0.05:
        step_map.observe(block(edge - walked - hip), hip)
        step_map.advance(speed / true_share * dt, dt)  # an odometry that reads 1 / true_share
        walked += speed * dt
    assert abs(step_map.slip - true_share) <= 0.25 * abs(1.0 - true_share) + 0.01  # the rest is caution
    step_map.observe(block(edge - walked - hip), hip)
    before = step_map.edges()[0][0]
    for _ in range(20):
        step_map.advance(speed / true_share * dt, dt)
    unlearned = abs(1.0 / true_share - 1.0)
    error = (before - step_map.edges()[0][0]) / (20 * speed * dt) - 1.0
    assert abs(error) <= 0.3 * unlearned + 0.02


def test_noise_of_the_block_is_not_taken_for_slip():
    rng, step_map = np.random.default_rng(0), StepMap()
    walked = 0.0
    for _ in range(200):
        step_map.observe(block(2.0 - walked + rng.normal(0, 0.008)), 0.24)
        step_map.advance(0.006, 1 / 48)
        walked += 0.006
    assert step_map.slip == pytest.approx(1.0, abs=0.05)
