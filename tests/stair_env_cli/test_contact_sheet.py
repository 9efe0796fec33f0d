import json
from pathlib import Path

import numpy as np
import pytest

from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sampling import Scene, SceneSampler, SceneSpec
from stair_env.sensors.camera.labels import LineLabel
from stair_env_cli.contact_sheet import (
    LABEL_COLOURS,
    contact_sheet,
    draw_labels,
    draw_view,
    false_colours,
    write_picture,
)
from stair_env_cli.main import main

SMALL = D435I_COLOR_MODES["640x480"].scaled(160, 120)


@pytest.fixture(scope="module")
def views():
    rng = np.random.default_rng(0)
    sampler = SceneSampler(lighting="day")
    return [draw_view(sampler.sample(rng), SMALL, rng) for _ in range(3)]


def test_a_day_view_shows_something(views):
    for view in views:
        assert view.rgb.shape == (120, 160, 3) and view.rgb.dtype == np.uint8
        assert view.rgb.std() > 5.0
        assert (view.depth_m > 0).mean() > 0.2
        assert len({label.kind for label in view.labels}) >= 1


def test_same_seed_same_view():
    def draw(sensor):
        rng = np.random.default_rng(5)
        return draw_view(SceneSampler().sample(rng), SMALL, rng, sensor=sensor)

    for sensor in (False, True):
        assert np.array_equal(draw(sensor).rgb, draw(sensor).rgb)
        assert np.array_equal(draw(sensor).depth_m, draw(sensor).depth_m)
    assert not np.array_equal(draw(False).depth_m, draw(True).depth_m)


def test_sheet_holds_every_picture(views):
    sheet = contact_sheet(views, columns=2, tile_width_px=80)
    assert sheet.shape == (2 * (60 + 4), 2 * 3 * (80 + 4), 3)
    assert (sheet[:64, :252] != sheet[64:, :252]).mean() > 0.3
    with pytest.raises(ValueError, match="views"):
        contact_sheet([])


def test_false_colours_tell_near_from_far_from_nothing():
    near, far, nothing = false_colours(np.array([[0.35, 3.5, 0.0]], np.float32))[0].astype(int)
    assert near[0] > near[2] and far[2] > far[0]
    assert (nothing == 0).all()


def test_labels_are_drawn_over_a_copy():
    rgb = np.zeros((40, 60, 3), np.uint8)
    drawn = draw_labels(rgb, [LineLabel("convex", 5.0, 20.5, 55.0, 20.5)])
    assert tuple(drawn[20, 30]) == LABEL_COLOURS["convex"]
    assert not rgb.any()


def test_write_picture_refuses_other_endings(tmp_path):
    with pytest.raises(ValueError, match=r"\.png"):
        write_picture(tmp_path / "sheet.gif", np.zeros((4, 4, 3), np.uint8))


class TestCommand:
    def test_writes_sheet_and_json(self, tmp_path, capsys):
        picture, results = tmp_path / "sheet.png", tmp_path / "sheet.json"
        arguments = ["--frames", "2", "--seed", "3", "--tile-width", "64", "--json", str(results)]
        assert main(["view", "--output", str(picture), *arguments]) == 0
        assert picture.read_bytes().startswith(b"\x89PNG")
        frames = json.loads(results.read_text())["frames"]
        assert len(frames) == 2
        assert Scene(SceneSpec.from_dict(frames[0]["scene"])).shapes
        assert str(picture) in capsys.readouterr().out

    def test_a_given_scene_is_drawn(self, tmp_path):
        scene = tmp_path / "scene.json"
        scene.write_text(SceneSampler(direction="down").sample(np.random.default_rng(0)).to_json())
        picture = tmp_path / "one.jpg"
        assert main(["view", "--scene", str(scene), "--frames", "1", "--output", str(picture)]) == 0
        assert picture.stat().st_size > 0

    @pytest.mark.parametrize(
        "arguments",
        [["--scene", "missing.json"], ["--negatives", "2"], ["--frames", "1", "--output", "sheet.gif"]],
    )
    def test_bad_input_is_one_line_and_a_code(self, arguments, capsys, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert main(["view", *arguments]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()[-1]) < 300
        assert not Path("view.png").exists()
