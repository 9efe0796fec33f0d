import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.task.curriculum import Curriculum, CurriculumConfig, read_curriculum


def test_curriculum_promotes_demotes_and_survives_a_checkpoint():
    curriculum = Curriculum(CurriculumConfig(start=0.05, levels=4, window=5), highest=0.17)
    for _ in range(5):
        curriculum.report(True)
    assert curriculum.level == 1 and curriculum.riser_height == pytest.approx(0.08)
    twin = Curriculum(curriculum.config, curriculum.highest)
    twin.restore(curriculum.state())
    for _ in range(5):
        curriculum.report(False)
        twin.report(False)
    assert curriculum.level == twin.level == 0
    for _ in range(5):
        curriculum.report(False)
    assert curriculum.level == 0
    for _ in range(100):
        curriculum.report(True)
    assert curriculum.level == 4 and curriculum.riser_height == pytest.approx(0.17)


@given(st.integers(0, 999), st.integers(0, 14))
def test_curriculum_never_draws_above_its_level(seed, level):
    curriculum = Curriculum(CurriculumConfig(), highest=0.17)
    curriculum.level = level
    assert 0.02 <= curriculum.draw_riser(0.1, np.random.default_rng(seed)) <= curriculum.riser_height + 1e-12


def test_options_name_what_is_wrong():
    assert read_curriculum(None, 0.2) is None
    with pytest.raises(SpecError, match="promote"):
        read_curriculum({"promotion": 0.5}, 0.2)
