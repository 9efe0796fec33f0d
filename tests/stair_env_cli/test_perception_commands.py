"""`stair-env dataset`, `perception-train` and `perception-evaluate`, as a user calls them."""

import json

import pytest

from perception.inference.weights import WeightsError, load_weights, weights_path
from stair_env_cli.main import main


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("cli") / "set"
    counts = ["--train", "4", "--val", "4", "--test", "4"]
    assert main(["dataset", "--output", str(root), *counts, "--seed", "5", "--json", str(root.parent / "d.json")]) == 0
    return root


def test_dataset_counts_as_the_paper_does(data):
    summary = json.loads((data.parent / "d.json").read_text())
    assert summary["images"] == 12 == summary["day"] + summary["night"]
    assert summary["seed"] == 5
    for split in ("train", "val", "test"):
        stems = [path.stem for path in sorted((data / split / "images").glob("*.jpg"))]
        assert stems == [path.stem for path in sorted((data / split / "depthes").glob("*.png"))]
        assert stems == [path.stem for path in sorted((data / split / "labels").glob("*.txt"))]
        assert all(stem.endswith(("_day", "_night")) for stem in stems)


def test_started_again_it_only_completes(data, capsys):
    image = next((data / "val" / "images").glob("*.jpg"))
    stamp = image.stat().st_mtime_ns
    counts = ["--train", "4", "--val", "4", "--test", "4"]
    assert main(["dataset", "--output", str(data), *counts, "--seed", "5"]) == 0
    assert image.stat().st_mtime_ns == stamp
    assert main(["dataset", "--output", str(data), *counts, "--seed", "6"]) == 2
    assert "another set" in capsys.readouterr().err


def test_stairs_and_viewpoints_can_be_chosen(tmp_path, capsys):
    chosen = ["--direction", "down", "--robot-share", "0", "--negatives", "0", "--seed", "3"]
    counts = ["--train", "6", "--val", "0", "--test", "0"]
    assert main(["dataset", "--output", str(tmp_path), *counts, *chosen]) == 0
    cars = [json.loads(path.read_text()) for path in (tmp_path / "train" / "images").glob("*.json")]
    assert {car["view"] for car in cars} <= {"descending", "none"} and len(cars) == 3
    assert main(["dataset", "--output", str(tmp_path), *counts, "--robot-share", "1.5", "--seed", "3"]) == 2
    assert "robot_share=1.5" in capsys.readouterr().err


def test_odd_numbers_of_images_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["dataset", "--output", str(tmp_path), "--val", "3"])
    assert stop.value.code == 2
    assert "even" in capsys.readouterr().err


def test_train_then_evaluate(data, tmp_path, capsys):
    run = tmp_path / "run"
    options = ["--data", str(data), "--output", str(run), "--epochs", "1", "--frames-per-epoch", "2", "--threads", "1"]
    options += ["--precision", "32-true"]  # the preset's is another
    assert main(["perception-train", *options, "--json", str(tmp_path / "card.json")]) == 0
    card = json.loads((tmp_path / "card.json").read_text())
    assert card["width"] == 0.25
    assert card["training"]["precision"] == "32-true"
    assert "val/iou" in card["metrics"]
    weights = run / "stairnetv2_025.safetensors"
    load_weights(weights, 0.25)

    rows = {}
    for file in (weights, run / "stairnetv2_025.onnx"):
        out = tmp_path / f"{file.suffix[1:]}.json"
        assert main(["perception-evaluate", "--data", str(data), "--weights", str(file), "--json", str(out)]) == 0
        rows[file.suffix] = json.loads(out.read_text())["rows"]
    assert rows[".onnx"] == rows[".safetensors"]
    first = rows[".onnx"][0]
    assert set(first) >= {"model", "width", "split", "accuracy", "recall", "iou", "frames"}
    assert (first["split"], first["frames"]) == ("all", 2)
    assert "IOU" in capsys.readouterr().out


def test_bad_input_is_one_line(tmp_path, capsys):
    assert main(["perception-train", "--data", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
    missing = str(tmp_path / "w.onnx")
    assert main(["perception-evaluate", "--data", str(tmp_path), "--weights", missing]) == 2
    assert "w.onnx: no such file" in capsys.readouterr().err


def test_missing_width_says_what_there_is(tmp_path):
    with pytest.raises(WeightsError, match=r"no onnx weights for width=0\.5 .* there are: none"):
        weights_path(0.5, "onnx", tmp_path)
