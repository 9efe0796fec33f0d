"""Tables 2, 3 and 6: what is trained, how it is scored, and what the sentences beside the numbers say."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from perception.data.stair_dataset import Sample, StairDataset
from perception.data.writer import DatasetPlan, write_missing
from perception.drawing import TRUE
from perception.learning.metrics import DetectionCounts
from perception.network import StairNetV2
from perception.reproduction.baselines.region_detector import region_of
from perception.reproduction.baselines.region_network import RoiNetwork
from perception.reproduction.baselines.region_score import RememberedRegions, box_iou, choose_least_score, region_note
from perception.reproduction.baselines.stairnet import StairNet, StairNetBackend
from perception.reproduction.table5_detection import Tally
from perception.reproduction.tables_2_3_6.figure7 import FOUND, brightened, compare, exemplary_frames
from perception.reproduction.tables_2_3_6.runs import LEARNED_ROWS, SUITE_PRESET, Run, RunError, load_run, train_missing
from perception.reproduction.tables_2_3_6.suite import SuitePlan, interleaved_cpu_ms, tuned_within_regions
from perception.reproduction.tables_2_3_6.tables import PAPER_TABLES, order_note, table_notes, table_rows
from stair_env_cli.main import main
from stair_env_cli.results_page import write_page

TINY = dataclasses.replace(
    SUITE_PRESET, epochs=1, frames_per_epoch=2, batch_size=2, small_batch_size=2, small_share=1.0
)
LINES = np.array([[100.0, 200, 300, 210], [110, 260, 310, 270]])


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("suite") / "set"
    list(write_missing(DatasetPlan(root, {"train": 2, "val": 2, "test": 4}, seed=3)))
    return root


def tally(iou, frames=10):
    """Counts whose IOU is the given per cent."""
    return Tally(DetectionCounts(round(100 * iou), 5000 - round(50 * iou), 5000 - round(50 * iou), frames))


def scores_of(**ious):
    """Row -> seeds from row -> IOU, or IOUs by (all, day, night), or a list of either."""
    out = {}
    for row, value in ious.items():
        seeds = value if isinstance(value, list) else [value]
        by_light = [seed if isinstance(seed, tuple) else (seed,) * 3 for seed in seeds]
        out[row] = [dict(zip(("all", "day", "night"), map(tally, light))) for light in by_light]
    return out


IN_ORDER = scores_of(classical=20, roi_classical=30, stairnet=(50, 52, 47), stairnetv2=(60, 61, 59))


def test_tables_have_a_row_for_every_training_and_end_with_the_papers_network():
    needed = {row.row for rows in PAPER_TABLES.values() for row in rows}
    assert needed - {"classical", "roi_classical"} == set(LEARNED_ROWS) - {"roi"}
    for rows in PAPER_TABLES.values():
        assert rows[-1].row == "stairnetv2"
        papers = [row.iou for row in rows if row.iou is not None]
        assert len(papers) > 1 and papers == sorted(papers)


def test_rows_stand_beside_the_papers():
    widths = {"stairnet": 0.25, "stairnetv2": 0.25, "roi_classical": 0.25}
    rows = table_rows(6, IN_ORDER, widths, dict.fromkeys(IN_ORDER, 12.34))
    assert [(row["model"], row["split"]) for row in rows[:4]] == [
        ("Gabor + Canny + Hough", "all"),
        ("Gabor + Canny + Hough", "day"),
        ("Gabor + Canny + Hough", "night"),
        ("YOLOv5 + Gabor + Canny + Hough", "all"),
    ]
    last = rows[9]
    assert (last["iou"], last["paper_iou"], last["cpu_ms"], last["paper_ms"]) == (60.0, 83.70, 12.3, 3.06)
    assert rows[10]["iou"] == 61.0
    assert "paper_iou" not in rows[10]
    assert rows[0]["width"] is None


def test_several_seeds_are_averaged_and_show_their_range():
    scores = IN_ORDER | scores_of(stairnetv2=[58, 62])
    row = table_rows(6, scores, {}, dict.fromkeys(scores, 1.0))[9]
    assert (row["iou"], row["iou_range"], row["seeds"]) == (60.0, [58.0, 62.0], 2)
    assert any("2 seeds, IOU 58.00 to 62.00" in note for note in table_notes(6, scores))


def test_notes_say_whether_the_order_is_the_papers():
    order, night = table_notes(6, IN_ORDER)
    assert order.endswith("the paper's order.")
    assert "9.00 points by day, 12.00 at night — larger at night, as" in night
    order, *_ = table_notes(6, IN_ORDER | scores_of(classical=35))
    assert "not the paper's order: YOLOv5 + Gabor + Canny + Hough should lead Gabor + Canny + Hough" in order
    assert "5.00 points behind" in order
    assert "differ" not in order
    spread = scores_of(classical=20, roi_classical=[15, 22, 20.9])
    assert order_note(6, spread).endswith("0.70 points behind, less than their seeds differ.")
    assert "differ" not in order_note(6, scores_of(classical=20, roi_classical=[18, 19]))
    assert "not larger" in table_notes(6, IN_ORDER | scores_of(stairnet=(50, 40, 58)))[-1]


def test_rows_that_are_not_trained_are_left_out_and_named():
    scores = {row: seeds for row, seeds in IN_ORDER.items() if row != "stairnet"}
    assert {row["model"] for row in table_rows(6, scores, {}, dict.fromkeys(scores, 1.0))} == {
        "Gabor + Canny + Hough",
        "YOLOv5 + Gabor + Canny + Hough",
        "StairNetV2",
    }
    notes = table_notes(6, scores)
    assert notes[0].endswith("the paper's order.")
    assert notes[-1] == "Not trained yet and left out: StairNet."


def test_close_rows_of_one_seed_are_not_told_apart():
    close = scores_of(stairnetv2=50.4, stairnetv2_fixed_weights=50.0)
    assert "not told apart" in table_notes(3, close)[-1]
    assert len(table_notes(3, scores_of(stairnetv2=52, stairnetv2_fixed_weights=50))) == 1
    thrice = scores_of(stairnetv2=[50.4, 50.3, 50.5], stairnetv2_fixed_weights=[50, 50, 50])
    assert not any("told apart" in note for note in table_notes(3, thrice))
    regions = IN_ORDER | scores_of(roi_classical=[20.5] * 3)
    assert not any("told apart" in note for note in table_notes(6, regions)), "classical lines have no seed"


def test_only_close_rows_ask_for_further_seeds(tmp_path):
    far = IN_ORDER | scores_of(stairnetv2_fixed_weights=55, stairnetv2_fusion_3=57, stairnetv2_fusion_4=58)
    plan = SuitePlan(tmp_path, tmp_path, TINY, close_seeds=(0, 5))
    assert plan.close_runs(far) == []
    close = far | scores_of(roi_classical=20.9, stairnetv2_fusion_4=60.5)
    runs = [(run.row, run.seed) for run in plan.close_runs(close)]
    assert runs == [("stairnetv2_fusion_4", 5), ("stairnetv2", 5), ("roi", 5)]
    assert dataclasses.replace(plan, seeds=(0, 5)).close_runs(close) == []


def frame(lines):
    image = np.zeros((512, 512, 3), np.uint8)
    return Sample(image, np.zeros((512, 512), np.float32), np.zeros(len(lines), np.int64), lines)


def test_iou_of_pixel_boxes():
    box = np.array([0.0, 0, 10, 10])
    assert box_iou(box, box) == 1.0
    assert box_iou(box, np.array([5.0, 0, 15, 10])) == pytest.approx(1 / 3)
    assert box_iou(box, np.array([20.0, 20, 30, 30])) == 0.0


def test_the_least_score_is_the_one_with_which_most_frames_are_right():
    frames = [frame(LINES), frame(LINES), frame(np.zeros((0, 4)))]
    right, wrong = region_of(LINES), np.array([0.0, 0, 20, 20])
    found = [np.array([[*right, 0.6]]), np.array([[*right, 0.42]]), np.array([[*wrong, 0.33]])]
    chosen = choose_least_score(found, frames)
    assert chosen.least_score == 0.35
    assert (chosen.right, chosen.mean_iou) == (100.0, 100.0)
    found[1] = np.array([[*wrong, 0.42]])
    assert choose_least_score(found, frames).right == pytest.approx(200 / 3)
    with pytest.raises(ValueError, match="answers"):
        choose_least_score(found[:2], frames)


def test_remembered_regions_are_found_once():
    frames, calls = [frame(LINES), frame(LINES)], []

    def find(rgb):
        calls.append(rgb)
        return np.array([[*region_of(LINES), 0.5], [0, 0, 9, 9, 0.2]])

    regions = RememberedRegions(find, frames)
    regions.least_score = 0.3
    assert all(regions(f.rgb).shape == (1, 5) for f in frames for _ in range(3))
    assert len(calls) == 2
    with pytest.raises(KeyError):
        regions(np.zeros((512, 512, 3), np.uint8))


def test_tuning_inside_regions_needs_no_good_regions(data, tmp_path):
    torch.manual_seed(0)
    plan = SuitePlan(data, tmp_path, TINY, trials=2)
    network, frames = RoiNetwork(0.25).eval(), [frame(LINES)] * 2
    detector, chosen, found = tuned_within_regions(network, frames, plan, lambda x, **_: iter(x))
    assert detector(frame(LINES).rgb, frame(LINES).depth_m).shape == (0, 4)
    assert 0.0 < found["regions"]["least_score"] == chosen.least_score < 1.0
    assert "says nothing about the method" in region_note("r", chosen)
    assert "says nothing" not in region_note("r", dataclasses.replace(chosen, mean_iou=70.0))
    assert found["trials"] == 2


def test_detectors_are_timed_by_turns():
    order = []
    timed = {name: lambda rgb, depth, name=name: order.append(name) for name in "ab"}
    times = interleaved_cpu_ms(timed, [frame(LINES)] * 3)
    assert order == list("ababab")
    assert all(value >= 0.0 for value in times.values())


def test_picture_shows_labels_and_every_method(data):
    lit = dataclasses.replace(frame(LINES), rgb=np.full((512, 512, 3), 40, np.uint8), meta={"lighting": "night"})
    frames = [lit, frame(np.zeros((0, 4)))]
    boxes = {"b": lambda rgb: np.array([[50.0, 50, 400, 400, 0.9]])}
    picture = compare(frames, {"a": lambda rgb, depth: LINES, "b": lambda rgb, depth: np.zeros((0, 4))}, boxes)
    assert picture.shape == (22 + 2 * 196, 3 * 196, 3)
    assert (picture[22:218, :196] == TRUE).all(-1).any(), "labels"
    assert not (picture[218:, :196] == TRUE).all(-1).any()
    assert (np.abs(picture[22:218, 196:392].astype(int) - FOUND).max(-1) < 40).any()
    blue = (picture[..., 2].astype(int) - picture[..., 0]) > 80
    assert blue[22:, 392:].any(), "the region"
    assert not blue[22:, :196].any()
    with pytest.raises(ValueError, match="frames"):
        compare([], {})
    assert brightened(lit.rgb).mean() == pytest.approx(90.0, abs=1.0)
    assert brightened(frames[1].rgb).max() == 0
    assert {f.view for f in exemplary_frames(StairDataset(data, "test"))} <= {"ascending", "descending", "none"}


def test_stairnet_back_end_is_the_network():
    torch.manual_seed(0)
    network = StairNet(0.25).eval()
    rgb = np.random.default_rng(0).integers(0, 255, (1, 512, 512, 3)).astype(np.uint8)
    cls, loc = StairNetBackend(network)(rgb, np.zeros((1, 512, 512), np.float32))
    with torch.inference_mode():
        expected = network((torch.from_numpy(rgb).movedim(-1, 1).float() / 255.0 - 0.5) / 0.5)
    np.testing.assert_allclose(cls, expected[0][:, 0].numpy(), atol=1e-3)
    np.testing.assert_allclose(loc, expected[1].movedim(1, -1).numpy(), atol=1e-3)


@pytest.mark.parametrize("row", ["stairnet", "roi"])
def test_a_run_is_trained_once_and_found_again(data, tmp_path, row):
    run = Run(row, 0, 0.25, TINY, data, tmp_path)
    with pytest.raises(RunError, match="not finished"):
        load_run(run)
    (done,) = train_missing([run], progress=False)
    weights = done.path / "weights.safetensors"
    stamp = weights.stat().st_mtime_ns
    list(train_missing([run], progress=False))
    assert weights.stat().st_mtime_ns == stamp
    network = load_run(run)
    assert isinstance(network, (StairNet, RoiNetwork))
    assert not network.training
    other = dataclasses.replace(run, preset=dataclasses.replace(TINY, epochs=2))
    with pytest.raises(RunError, match="epochs 1 instead of 2"):
        list(train_missing([other], progress=False))


def test_a_run_from_before_a_setting_existed_is_gone_on_with(tmp_path):
    run = Run("stairnet", 0, 0.25, TINY, tmp_path / "set", tmp_path / "runs")
    older = run.settings()
    del older["frozen_statistics"]
    run.path.mkdir(parents=True)
    (run.path / "settings.json").write_text(json.dumps(older))
    run.check_settings()
    with pytest.raises(RunError, match="frozen_statistics False instead of True"):
        dataclasses.replace(run, preset=dataclasses.replace(TINY, frozen_statistics=True)).check_settings()


def test_the_rows_share_all_but_the_regions_size():
    own = {row: learned.preset(SUITE_PRESET) for row, learned in LEARNED_ROWS.items()}
    assert dataclasses.replace(own.pop("roi"), small_share=SUITE_PRESET.small_share) == SUITE_PRESET
    assert set(own.values()) == {SUITE_PRESET}
    assert not SUITE_PRESET.is_small(SUITE_PRESET.epochs - 1)
    assert LEARNED_ROWS["roi"].preset(SUITE_PRESET).is_small(SUITE_PRESET.epochs - 1)


def test_rows_differ_in_what_they_are_about():
    made = {row: learned.make(0.25, TINY) for row, learned in LEARNED_ROWS.items()}
    stages = {row: m.network.fusion_stage for row, m in made.items() if isinstance(m.network, StairNetV2)}
    assert stages == {
        "stairnetv2": 2,
        "stairnetv2_fixed_weights": 2,
        "stairnetv2_fusion_3": 3,
        "stairnetv2_fusion_4": 4,
        "concatenation": 2,
        "four_channels": 2,
    }
    assert len({type(made[row].network) for row in ("stairnetv2", "concatenation", "four_channels")}) == 3
    fixed = made["stairnetv2_fixed_weights"]
    assert not fixed.preset.dynamic_weights
    assert (fixed.loss_weights.x, fixed.loss_weights.y) == (4.0, 16.0)
    assert made["stairnetv2"].preset.dynamic_weights
    with pytest.raises(ValueError, match="row"):
        Run("stairnetv3", 0, 0.25, TINY, None, None)


def test_the_suite_wants_a_set_and_one_width(data, capsys):
    assert main(["perception-evaluate", "--suite", "paper"]) == 2
    assert "--data" in capsys.readouterr().err
    assert main(["perception-evaluate", "--suite", "paper", "--data", str(data), "--width", "0.25,0.5"]) == 2
    assert "one width" in capsys.readouterr().err


@pytest.mark.slow
def test_one_command_trains_and_writes_the_tables(data, tmp_path, capsys):
    options = [
        "--suite",
        "paper",
        "--data",
        str(data),
        "--runs",
        str(tmp_path / "runs"),
        "--results",
        str(tmp_path / "r"),
    ]
    options += ["--epochs", "1", "--frames-per-epoch", "2", "--trials", "2", "--tune-frames", "2", "--seed", "4"]
    options += ["--close-seeds", "0"]
    assert main(["perception-evaluate", *options]) == 0
    reports = {n: json.loads((tmp_path / "r" / f"table{n}.json").read_text()) for n in (2, 3, 6)}
    assert [len({row["model"] for row in reports[n]["rows"]}) for n in (2, 3, 6)] == [3, 2, 4]
    assert all(row["frames"] == 4 for row in reports[6]["rows"] if row["split"] == "all")
    assert {"classical", "roi_classical, seed 0"} == set(reports[6]["tuning"])
    assert "order" in capsys.readouterr().out
    page = write_page(tmp_path / "r").read_text()
    assert "![table6](table6.png)" in page
    assert reports[6]["notes"][0] in page

    def scores():
        return {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("*/test_scores.json")}

    before = scores()
    assert len(before) == len(LEARNED_ROWS) - 1, "of all rows but the region detector, which has steps to tune"
    assert main(["perception-evaluate", *options]) == 0
    assert scores() == before, "trained and scored already"
    again = json.loads((tmp_path / "r" / "table2.json").read_text())
    assert [row["iou"] for row in again["rows"]] == [row["iou"] for row in reports[2]["rows"]]
