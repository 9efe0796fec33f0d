"""The region detector and classical detection inside its regions, on images with known lines."""

import itertools

import numpy as np
import pytest
import torch

from perception.data.stair_dataset import Sample
from perception.inference.batchnorm_fusion import folded
from perception.learning.frames import halved
from perception.reproduction.baselines.baseline_training import roi_arrays
from perception.reproduction.baselines.classical import ClassicalDetector, ClassicalParameters
from perception.reproduction.baselines.line_detector import score_lines
from perception.reproduction.baselines.region_detector import RegionFinder, RoiClassicalDetector, region_of, suppress
from perception.reproduction.baselines.region_loss import Regions, answering_cells, complete_iou, roi_loss
from perception.reproduction.baselines.region_network import ANCHORS_PX, STRIDES, RoiNetwork, decode_boxes

NO_DEPTH = np.zeros((512, 512), dtype=np.float32)
STAND_IN = ClassicalParameters(wavelength_px=8.0, least_deviation=2.0)
STAIRS = np.array([60.0, 80.0, 300.0, 330.0])  # x1 y1 x2 y2
ANCHORS = torch.tensor(ANCHORS_PX) / 512.0


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def stripes(rgb, box, rows):
    """Paint bands between the rows of a box; returns the lines between them."""
    x1, y1, x2, y2 = box.astype(int)
    edges = np.linspace(y1, y2, rows + 1).round().astype(int)
    for number, (top, bottom) in enumerate(itertools.pairwise(edges)):
        rgb[top:bottom, x1:x2] = 200 if number % 2 else 60
    return np.array([[x1, y, x2, y] for y in edges[1:-1]], dtype=np.float64)


def picture_with_distractor(rng):
    """Stairs in one place, a zebra crossing in another; (rgb, the stairs' lines)."""
    rgb = np.full((512, 512, 3), 120, dtype=np.uint8)
    lines = stripes(rgb, STAIRS, 6)
    stripes(rgb, np.array([320.0, 350.0, 500.0, 500.0]), 5)
    noise = rng.normal(0.0, 2.0, rgb.shape)
    return np.clip(rgb + noise, 0.0, 255.0).astype(np.uint8), lines


def test_size_is_that_of_yolov5_nano():
    # YOLOv5n with one class has 1 765 270 parameters (its own summary); 1353 of them score the class, left out here.
    assert sum(p.numel() for p in RoiNetwork(0.25).parameters()) == 1_765_270 - 1_353
    with pytest.raises(ValueError, match="width"):
        RoiNetwork(0.3)


@pytest.mark.parametrize("size", [256, 512])
def test_output_covers_three_strides_within_bounds(size):
    torch.manual_seed(0)
    network = RoiNetwork(0.25).eval()
    image = torch.randn(2, 3, size, size)
    raw, found = network.forward_raw(image), network(image)
    assert [tuple(grid.shape) for grid in raw] == [(2, 3, size // s, size // s, 5) for s in STRIDES]
    assert found.shape == (2, sum(3 * (size // s) ** 2 for s in STRIDES), 5)
    assert bool(((found[..., 4] >= 0) & (found[..., 4] <= 1) & (found[..., 2:4] > 0).all(-1)).all())
    torch.testing.assert_close(folded(network)(image), found, atol=1e-4, rtol=1e-3)


def test_boxes_decode_to_cell_and_anchor():
    raw = torch.zeros(1, 3, 16, 16, 5)  # sigmoid 0.5: the middle of the cell, the anchor's own size
    boxes = decode_boxes(raw, ANCHORS[2])
    torch.testing.assert_close(boxes[0, 1, 3, 7], torch.tensor([7.5 / 16, 3.5 / 16, 1.0, 233 / 512]))
    far = decode_boxes(raw + 20.0, ANCHORS[2])[0, 1, 3, 7]
    torch.testing.assert_close(far, torch.tensor([8.5 / 16, 4.5 / 16, 4.0, 4 * 233 / 512]))


def test_iou_of_boxes():
    a = torch.tensor([0.5, 0.5, 0.4, 0.2])
    assert complete_iou(a, a).item() == pytest.approx(1.0, abs=1e-5)
    half = torch.tensor([0.6, 0.5, 0.2, 0.2])  # IOU 1/2, centres 0.1 apart, hull 0.4 x 0.2
    slant = 4 / np.pi**2 * (np.arctan(2.0) - np.arctan(1.0)) ** 2
    expected = 0.5 - 0.01 / 0.2 - slant**2 / (0.5 + slant)
    assert complete_iou(a, half).item() == pytest.approx(expected, abs=1e-5)
    assert complete_iou(a, torch.tensor([0.1, 0.9, 0.1, 0.1])).item() < 0.0


def test_cells_around_the_centre_answer():
    there = torch.tensor([True, True, False])
    boxes = torch.tensor([[0.3, 0.7, 0.9, 0.5], [0.01, 0.99, 0.9, 0.02], [0.5, 0.5, 0.5, 0.5]])
    answers = answering_cells(Regions(there, boxes), ANCHORS[2], 16, 16)
    rows, columns = np.nonzero(answers[0, 1].numpy())
    # 0.3 * 16 = 4.8 faces column 5, 0.7 * 16 = 11.2 faces row 10.
    assert set(zip(rows.tolist(), columns.tolist())) == {(11, 4), (11, 5), (10, 4)}
    assert not answers[1].any(), "a box of height 0.02 is more than four times flatter than these anchors"
    assert not answers[2].any()
    assert answering_cells(Regions(there, boxes), ANCHORS[0], 64, 64)[1].any()


def test_loss_falls_with_the_right_answer_and_only_there():
    regions = Regions(torch.tensor([True]), torch.tensor([[0.469, 0.469, 1.0, 233 / 512]]))
    empty = [torch.full((1, 3, 512 // s, 512 // s, 5), -6.0) for s in STRIDES]
    placed, right, wrong = ([grid.clone() for grid in empty] for _ in range(3))
    for raw in (placed, right, wrong):
        raw[2][0, :, 7, 7, :4] = 0.0
    right[2][0, 1, 7, 7, 4] = 6.0
    wrong[2][0, 1, 2, 12, 4] = 6.0
    unplaced, silent, found, misplaced = (roi_loss(raw, regions, ANCHORS) for raw in (empty, placed, right, wrong))
    assert silent["box"] < unplaced["box"]
    assert found["score"] < silent["score"] < misplaced["score"]
    nothing = roi_loss(empty, Regions(torch.tensor([False]), torch.zeros(1, 4)), ANCHORS)
    assert nothing["box"].item() == 0.0


def test_region_around_lines():
    lines = np.array([[100.0, 200, 300, 210], [-40, 90, 620, 80]])
    np.testing.assert_allclose(region_of(lines), [0, 80, 512, 210])
    np.testing.assert_allclose(region_of(lines / 2, 256), np.array([0, 80, 512, 210]) / 2)
    flat = region_of(np.array([[100.0, 200, 300, 200]]))
    assert (flat[3] - flat[1], flat[2] - flat[0]) == (8.0, 200.0)
    assert region_of(np.zeros((0, 4))) is None
    assert region_of(np.array([[-30.0, -20, -5, -3]])) is None


def test_target_of_a_frame_follows_its_lines(rng):
    rgb, lines = picture_with_distractor(rng)
    sample = Sample(rgb, NO_DEPTH, np.zeros(len(lines), np.int64), lines)
    image, there, box = roi_arrays(sample)
    assert image.shape == (3, 512, 512)
    assert bool(there)
    x1, y1, x2, y2 = region_of(lines) / 512
    np.testing.assert_allclose(box, [(x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1], atol=1e-6)
    np.testing.assert_allclose(roi_arrays(halved(sample))[2], box, atol=1e-6)
    assert not roi_arrays(Sample(rgb, NO_DEPTH, np.zeros(0, np.int64), np.zeros((0, 4))))[1]


def test_of_overlapping_boxes_the_best_stays():
    found = np.array(
        [[100.0, 100, 80, 40, 0.6], [104, 100, 80, 40, 0.9], [400, 300, 50, 50, 0.7], [400, 100, 9, 9, 0.1]]
    )
    kept = suppress(found, 0.25)
    np.testing.assert_allclose(kept, [[64, 80, 144, 120, 0.9], [375, 275, 425, 325, 0.7]], atol=1e-6)
    assert suppress(found, 0.95).shape == (0, 5)


def test_a_finder_refuses_a_score_out_of_range():
    with pytest.raises(ValueError, match="least_score"):
        RegionFinder(RoiNetwork(0.25), 1.0)


def test_the_size_that_the_network_sees_does_not_change_the_unit():
    torch.manual_seed(0)
    rgb = np.random.default_rng(0).integers(0, 255, (512, 512, 3)).astype(np.uint8)
    network = RoiNetwork(0.25).eval()
    with torch.no_grad():
        for head in network.heads:
            head.bias.view(3, 5)[:, 4] = 3.0  # everything is found
    for size_px in (512, 256):
        found = RegionFinder(network, 0.5, size_px)(rgb)
        assert found[:, 2].max() > 450.0, size_px
    with pytest.raises(ValueError, match="size_px"):
        RegionFinder(network, 0.5, 100)


def test_lines_are_found_inside_the_region_only(rng):
    rgb, lines = picture_with_distractor(rng)
    sample = Sample(rgb, NO_DEPTH, np.zeros(len(lines), np.int64), lines)
    inside = RoiClassicalDetector(lambda _: np.array([[*region_of(lines), 0.9]]), STAND_IN)
    found = inside(rgb, NO_DEPTH)
    assert len(found) >= len(lines) - 1
    assert found[:, [0, 2]].max() < 320
    whole, cropped = score_lines(ClassicalDetector(STAND_IN), [sample]), score_lines(inside, [sample])
    assert cropped.accuracy > whole.accuracy + 20.0
    assert cropped.recall >= 80.0


def test_no_region_no_lines_and_two_regions_join(rng):
    rgb, lines = picture_with_distractor(rng)
    assert RoiClassicalDetector(lambda _: np.zeros((0, 5)), STAND_IN)(rgb, NO_DEPTH).shape == (0, 4)
    box = [*region_of(lines), 0.9]
    once = RoiClassicalDetector(lambda _: np.array([box]), STAND_IN)(rgb, NO_DEPTH)
    twice = RoiClassicalDetector(lambda _: np.array([box, box]), STAND_IN)(rgb, NO_DEPTH)
    np.testing.assert_allclose(np.sort(twice, axis=0), np.sort(once, axis=0), atol=1.0)
    beyond = RoiClassicalDetector(lambda _: np.array([[600.0, 600, 700, 700, 0.9]]), STAND_IN)
    assert beyond(rgb, NO_DEPTH).shape == (0, 4)


def test_it_learns_where_the_stairs_are():
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    network = RoiNetwork(0.25)
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    rgb, box = [], []
    for x, y in ((20, 60), (120, 30), (60, 130), (10, 10)):
        image = np.full((256, 256, 3), 100, dtype=np.uint8)
        lines = stripes(image, np.array([x, y, x + 120, y + 100.0]), 5)
        sample = Sample(image, np.zeros((256, 256), np.float32), np.zeros(len(lines), np.int64), lines)
        arrays = roi_arrays(sample)
        rgb.append(torch.from_numpy(arrays[0] + rng.normal(0, 0.02, arrays[0].shape).astype(np.float32)))
        box.append(torch.from_numpy(arrays[2]))
    image, regions = torch.stack(rgb), Regions(torch.ones(4, dtype=torch.bool), torch.stack(box))
    for _ in range(60):
        terms = roi_loss(network.forward_raw(image), regions, network.anchors)
        optimiser.zero_grad()
        (terms["box"] + terms["score"]).backward()
        optimiser.step()
    found = network(image).detach()  # batch norm's running means have not settled after so few steps
    best = found[torch.arange(4), found[..., 4].argmax(dim=1)]
    assert complete_iou(best[:, :4], regions.boxes).min() > 0.6
