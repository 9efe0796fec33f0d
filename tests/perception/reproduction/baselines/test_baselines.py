"""The paper's opponents on images with known lines."""

import json

import cv2
import numpy as np
import pytest
import torch

from perception.data.label_grid import encode_grid, format_labels
from perception.data.stair_dataset import Sample
from perception.learning.losses import total_loss
from perception.network import StairNetV2, state_dict_megabytes
from perception.reproduction.baselines.classical import (
    ClassicalDetector,
    ClassicalParameters,
    content_box,
    merge_lines,
    near_horizontal,
)
from perception.reproduction.baselines.classical_tuning import draw_parameters, tune
from perception.reproduction.baselines.line_detector import GridDetector, LineBackend, lines_to_grid, score_lines
from perception.reproduction.baselines.stairnet import (
    ASPP_RATES,
    WEIGHTS,
    StairNet,
    StairNetBackend,
    encode_targets,
    stairnet_loss,
)
from stair_env.common.constants import NETWORK_WIDTHS
from stair_env_cli.main import main

NO_DEPTH = np.zeros((512, 512), dtype=np.float32)
STAND_IN = ClassicalParameters(wavelength_px=8.0, least_deviation=2.0)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def striped_picture(rng, *, noise=3.0):
    """A stack of steps, each of another grey, seen at a small roll; (rgb, the lines between them)."""
    slope = np.tan(np.radians(rng.uniform(-8.0, 8.0)))
    rows = np.cumsum(rng.uniform(35.0, 60.0, size=7)) + 70.0
    lines = np.array([[30.0, y - slope * 226.0, 482.0, y + slope * 226.0] for y in rows])
    grey = np.full((512, 512), 60.0)
    for number, (x1, y1, x2, y2) in enumerate(lines):
        below = np.array([[x1, y1], [x2, y2], [x2, 700.0], [x1, 700.0]])
        cv2.fillPoly(grey, [np.round(below).astype(np.int32)], 200.0 if number % 2 == 0 else 80.0)
    grey += rng.normal(0.0, noise, grey.shape)
    return np.repeat(np.clip(grey, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=2), lines


def found_share(found, true, tolerance_px=4.0):
    """Share of the true lines that some found line follows over at least half their length."""
    hits = 0
    for x1, y1, x2, y2 in true:
        slope = (y2 - y1) / (x2 - x1)
        off = np.abs(found[:, [1, 3]] - (y1 + slope * (found[:, [0, 2]] - x1))).max(axis=1)
        overlap = np.minimum(found[:, 2], x2) - np.maximum(found[:, 0], x1)
        hits += bool(np.any((off <= tolerance_px) & (overlap >= 0.5 * (x2 - x1))))
    return hits / len(true)


def sample(rng):
    rgb, lines = striped_picture(rng)
    return Sample(rgb, NO_DEPTH, np.zeros(len(lines), np.int64), lines)


def test_classical_finds_strong_edges(rng):
    shares = []
    for _ in range(8):
        rgb, lines = striped_picture(rng)
        shares.append(found_share(ClassicalDetector(STAND_IN)(rgb, NO_DEPTH), lines))
    assert np.mean(shares) >= 0.8


def test_classical_scores_high_where_every_edge_is_a_stair_line(rng):
    counts = score_lines(ClassicalDetector(STAND_IN), [sample(rng) for _ in range(4)])
    assert counts.recall >= 75.0
    assert counts.accuracy >= 60.0


def test_classical_on_depth_finds_steps_in_depth(rng):
    rgb, lines = striped_picture(rng, noise=0.0)
    depth = np.where(rgb[..., 0] > 100, 1.0, 1.4).astype(np.float32)
    grey = np.full((512, 512, 3), 128, dtype=np.uint8)
    detect = ClassicalDetector(ClassicalParameters(image="depth"))
    assert found_share(detect(grey, depth), lines) >= 0.8
    assert len(detect(grey, np.ones_like(depth))) == 0


@pytest.mark.parametrize("level", [0, 5, 128, 255])
def test_nothing_is_found_in_an_empty_picture(level):
    assert ClassicalDetector()(np.full((512, 512, 3), level, np.uint8), NO_DEPTH).shape == (0, 4)


def test_padding_of_the_letterbox_is_no_line():
    rgb = np.zeros((512, 512, 3), dtype=np.uint8)
    rgb[64:448] = 150
    assert content_box(rgb) == (64, 448, 0, 512)
    assert len(ClassicalDetector()(rgb, NO_DEPTH)) == 0


def test_same_picture_gives_the_same_lines(rng):
    rgb, _ = striped_picture(rng)
    first = ClassicalDetector()(rgb, NO_DEPTH)
    assert len(first)
    np.testing.assert_array_equal(first, ClassicalDetector()(rgb, NO_DEPTH))


def test_steep_lines_are_left_out():
    lines = np.array([[0.0, 0, 100, 10], [0, 0, 10, 100], [100, 20, 0, 0], [5, 0, 5, 50]])
    np.testing.assert_array_equal(near_horizontal(lines, 30.0), [[0, 0, 100, 10], [0, 0, 100, 20]])


def test_pieces_of_a_line_become_the_line(rng):
    for _ in range(20):
        y, slope = rng.uniform(100.0, 400.0), rng.uniform(-0.3, 0.3)
        cuts = np.sort(rng.uniform(20.0, 490.0, size=8)).reshape(4, 2)
        cuts[1:, 0] = cuts[:-1, 1] - 5.0
        cuts = cuts[cuts[:, 1] - cuts[:, 0] > 1.0]
        pieces = np.column_stack([cuts[:, 0], y + slope * cuts[:, 0], cuts[:, 1], y + slope * cuts[:, 1]])
        whole = merge_lines(pieces, 2.0, 500.0)
        ends = np.array([cuts.min(), cuts.max()])
        np.testing.assert_allclose(whole, [[ends[0], y + slope * ends[0], ends[1], y + slope * ends[1]]], atol=1e-6)


def test_lines_apart_stay_apart():
    lines = np.array([[0.0, 100, 200, 100], [0, 120, 200, 120], [300, 100, 400, 100]])
    assert len(merge_lines(lines, 6.0, 20.0)) == 3
    assert len(merge_lines(lines, 6.0, 100.0)) == 2
    assert merge_lines(np.zeros((0, 4)), 6.0, 20.0).shape == (0, 4)


@pytest.mark.parametrize(
    "change",
    [{"image": "infrared"}, {"votes": 0}, {"wavelength_px": 1.0}, {"sigma_ratio": float("nan")}, {"canny_low": 900.0}],
)
def test_bad_parameters_are_named(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        ClassicalParameters(**change)


def test_search_is_reproducible_and_no_worse_than_the_defaults(rng):
    frames = [sample(rng) for _ in range(2)]
    found = tune(frames, np.random.default_rng(1), 3)
    assert found == tune(frames, np.random.default_rng(1), 3)
    assert found.counts.frames == 2
    heat = frames[::6]
    best, default = (score_lines(ClassicalDetector(p), heat).iou for p in (found.parameters, ClassicalParameters()))
    assert best >= default
    with pytest.raises(ValueError, match="trials"):
        tune(frames, rng, 0)


def test_every_draw_is_valid(rng):
    assert len({draw_parameters(rng) for _ in range(200)}) == 200


def test_true_lines_score_full_marks(rng):
    frame = sample(rng)
    counts = score_lines(lambda rgb, depth: frame.lines, [frame])
    assert (counts.accuracy, counts.recall, counts.iou) == (100.0, 100.0, 100.0)


def test_backend_of_a_line_detector_is_its_grid(rng):
    rgb, lines = striped_picture(rng)
    backend = LineBackend(lambda colour, depth: lines if colour.any() else lines[:0])
    cls, loc = backend(np.stack([rgb, np.zeros_like(rgb)]), np.stack([NO_DEPTH, NO_DEPTH]))
    np.testing.assert_array_equal(cls[0], encode_grid(lines).cls)
    np.testing.assert_array_equal(loc[0], encode_grid(lines).loc)
    assert not cls[1].any()
    assert backend(np.zeros((0, 512, 512, 3), np.uint8), np.zeros((0, 512, 512), np.float32))[0].shape == (0, 32, 16)
    with pytest.raises(ValueError, match="uint8"):
        backend(rgb[None].astype(np.float32), NO_DEPTH[None])


def test_lines_of_a_grid_give_the_grid_back(rng):
    _, lines = striped_picture(rng)
    grid = encode_grid(lines)
    back = lines_to_grid(GridDetector(lambda rgb, depth: (grid.cls[None], grid.loc[None]))(NO_DEPTH, NO_DEPTH))
    np.testing.assert_array_equal(back.cls, grid.cls)


@pytest.mark.parametrize("width", NETWORK_WIDTHS)
def test_stairnet_is_about_three_times_stairnetv2(width):
    ratio = state_dict_megabytes(StairNet(width)) / state_dict_megabytes(StairNetV2(width))
    assert 2.5 <= ratio <= 3.5


def test_stairnet_has_stairnetv2_s_output(rng):
    torch.manual_seed(0)
    rgb, _ = striped_picture(rng)
    cls, loc = StairNetBackend(StairNet(0.25))(rgb[None], NO_DEPTH[None])
    assert (cls.shape, loc.shape) == ((1, 32, 16), (1, 32, 16, 8))
    for values in (cls, loc):
        assert values.dtype == np.float32
        assert ((values >= 0.0) & (values <= 1.0)).all()


def test_stairnet_refuses_another_width():
    with pytest.raises(ValueError, match="width"):
        StairNet(0.3)


def test_stairnet_sees_farther_along_rows_than_across():
    torch.manual_seed(0)
    stage = StairNet(0.25).features[3].double()
    for module in stage.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.ones_(module.weight)
        if type(module).__name__ == "SqueezeExcite":  # gates look at the whole image
            module.forward = lambda x: x
    image = torch.randn(1, 64, 41, 81, dtype=torch.float64, requires_grad=True)
    stage.eval()(image)[0, :, 20, 40].sum().backward()
    seen = image.grad[0].abs().sum(0) > 0
    assert seen.any(0).sum() > 2 * seen.any(1).sum()
    assert len(ASPP_RATES) == 3


def test_kinds_of_cells(rng):
    lines = np.array([[0.0, 40, 512, 40], [0, 200, 512, 200], [0, 345, 512, 345], [0, 347, 16, 347]])
    targets = encode_targets(lines, np.array([0, 1, 0, 1]))
    kinds = targets.kinds[0].numpy()
    assert set(kinds[2]) == {1}
    assert set(kinds[12]) == {2}
    assert set(kinds[21]) == {1}, "the longer piece decides"
    np.testing.assert_array_equal(kinds > 0, encode_grid(lines).cls > 0)
    assert not encode_targets(np.zeros((0, 4)), np.zeros(0)).kinds.any()
    with pytest.raises(ValueError, match="kinds"):
        encode_targets(lines, np.array([0]))


def test_loss_weighs_as_equation_1():
    assert (WEIGHTS.x, WEIGHTS.y) == (4.0, 16.0)


def test_empty_cells_have_no_location_loss():
    torch.manual_seed(0)
    targets = encode_targets(np.zeros((0, 4)), np.zeros(0))
    terms = stairnet_loss(StairNet(0.25).forward_raw(torch.randn(1, 3, 512, 512)), targets)
    terms = {name: term.detach() for name, term in terms.items()}
    assert float(terms["x"]) == float(terms["y"]) == 0.0
    assert float(terms["cls"]) > 0.0


def test_every_parameter_learns_and_the_loss_falls():
    torch.manual_seed(0)
    network = StairNet(0.25)
    lines = np.array([[5.0, 20, 60, 24], [5, 50, 60, 46]])
    whole = encode_targets(lines, np.array([0, 1]))
    targets = type(whole)(whole.kinds[:, :4, :2], whole.loc[:, :, :4, :2])
    image = torch.randn(1, 3, 64, 64)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    losses = []
    for _ in range(4):
        loss = total_loss(stairnet_loss(network.forward_raw(image), targets), WEIGHTS)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    idle = [n for n, p in network.named_parameters() if p.grad is None or not bool(torch.isfinite(p.grad).all())]
    assert not idle
    assert all(bool(p.grad.any()) for n, p in network.named_parameters() if "gates" not in n)
    assert losses[-1] < losses[0]


def test_command_scores_the_classical_suite(rng, tmp_path, capsys):
    for split in ("val", "test"):
        for name in ("images", "depthes", "labels"):
            (tmp_path / split / name).mkdir(parents=True)
        for number, lighting in enumerate(("day", "night")):
            frame = sample(rng)
            stem = tmp_path / split
            cv2.imwrite(str(stem / "images" / f"{number}.jpg"), frame.rgb)
            (stem / "images" / f"{number}.json").write_text(json.dumps({"lighting": lighting, "view": "ascending"}))
            cv2.imwrite(str(stem / "depthes" / f"{number}.png"), np.full((512, 512), 1000, np.uint16))
            (stem / "labels" / f"{number}.txt").write_text(format_labels(frame.kinds, frame.lines))
    out = tmp_path / "rows.json"
    options = ["--suite", "classical", "--data", str(tmp_path), "--trials", "2", "--json", str(out)]
    assert main(["perception-evaluate", *options]) == 0
    report = json.loads(out.read_text())
    assert [row["split"] for row in report["rows"]] == ["all", "day", "night", "ascending"]
    assert all(row.keys() >= {"model", "width", "accuracy", "recall", "iou", "frames"} for row in report["rows"])
    assert report["rows"][0]["frames"] == 2
    assert report["rows"][0]["recall"] > 50.0
    assert "Gabor" in capsys.readouterr().out
