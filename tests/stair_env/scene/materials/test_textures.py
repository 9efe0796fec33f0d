import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.scene.materials.textures import MATERIALS, TEXTURE_SIZE_PX, make_texture, noise


def roughness(values):
    return float(np.abs(values).mean())


@pytest.mark.parametrize("material", MATERIALS)
class TestMaterials:
    def test_shape_type_and_ranges(self, material):
        texture = make_texture(material, 0)
        assert texture.albedo.shape == (TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3)
        assert texture.albedo.dtype == np.uint8
        assert 0.1 <= texture.metres_per_tile <= 2.0
        assert 0.0 <= texture.specular <= 1.0
        assert 4.0 <= texture.shininess <= 120.0
        assert 0.0 <= texture.depth_dropout <= 1.0

    def test_same_seed_same_texture(self, material):
        again = make_texture.__wrapped__(material, 3)
        assert np.array_equal(make_texture(material, 3).albedo, again.albedo)

    def test_another_seed_another_texture(self, material):
        assert not np.array_equal(make_texture(material, 1).albedo, make_texture(material, 2).albedo)

    def test_no_seam_where_it_repeats(self, material):
        for seed in range(4):
            albedo = make_texture(material, seed).albedo.astype(float)
            for axis in (0, 1):
                inside = np.abs(np.diff(albedo, axis=axis)).mean(axis=(1 - axis, 2))
                wrap = roughness(np.take(albedo, 0, axis) - np.take(albedo, -1, axis))
                assert wrap <= inside.max() + 2.0  # a seam would be steeper than any step inside

    def test_wear_tiles_too_and_grows(self, material):
        new = make_texture(material, 2).albedo.astype(float)
        change = []
        for wear in (1, 3):
            albedo = make_texture(material, 2, wear).albedo.astype(float)
            change.append(np.abs(albedo - new).mean())
            for axis in (0, 1):
                inside = np.abs(np.diff(albedo, axis=axis)).mean(axis=(1 - axis, 2))
                assert roughness(np.take(albedo, 0, axis) - np.take(albedo, -1, axis)) <= inside.max() + 2.0
        assert 0.1 < change[0] < change[1] < 80.0

    def test_is_not_flat_and_not_clipped(self, material):
        albedo = make_texture(material, 5).albedo
        assert albedo.std() > 0.5
        assert np.isin(albedo, (0, 255)).mean() < 0.2

    def test_is_read_only_because_it_is_shared(self, material):
        with pytest.raises(ValueError, match="read-only"):
            make_texture(material, 0).albedo[0, 0] = 0


def test_textures_are_cached():
    assert make_texture("wood", 7) is make_texture("wood", 7)


def test_unknown_material_names_the_choices():
    with pytest.raises(SpecError, match="terrazzo"):
        make_texture("jelly", 0)


@pytest.mark.parametrize("low, high", [(1, 8), (30, 100)])
def test_noise_is_normalised_and_stays_in_its_band(low, high):
    field = noise(np.random.default_rng(0), low, high)
    assert abs(field.mean()) < 0.05
    assert field.std() == pytest.approx(1.0, abs=1e-3)
    power = np.abs(np.fft.fft2(field)) ** 2
    axis = np.fft.fftfreq(TEXTURE_SIZE_PX, 1 / TEXTURE_SIZE_PX)
    radius = np.hypot(axis[:, None], axis[None, :])
    assert power[(radius < low - 0.01) | (radius > high + 0.01)].sum() < 1e-6 * power.sum()


def test_stretched_noise_varies_less_along_the_columns():
    field = noise(np.random.default_rng(1), 10, 100, stretch=10.0)
    assert roughness(np.diff(field, axis=1)) < 0.3 * roughness(np.diff(field, axis=0))
