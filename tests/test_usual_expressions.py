"""What expressions usually are: learned moments, and the two terms that judge weights by them."""

import json

import numpy as np
import pytest
from safetensors.numpy import save_file

from tests.scenes import make_scene
from workbench.config import Config, preset
from workbench.energies import FACE_IT_TERMS, TABLE
from workbench.energies.context import TermContext, still
from workbench.energies.total import residual_of
from workbench.errors import ModelError
from workbench.face import GAZE_NAMES, FaceParameters, landmark_model, load_default_head, principal_expressions
from workbench.face.usual_expressions import (
    LEAST_DEVIATION,
    ONE_SIDED,
    Moments,
    bundled_moments,
    read_moments,
    usual_expressions,
    write_moments,
)
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter, FrameContext

LAUGH = {"mouthSmile": 0.9, "cheekSquint": 0.7, "eyeSquint": 0.5, "mouthUpperUp": 0.4}
NAMES = load_default_head().expression_names


def weights(names=NAMES, **given: float) -> np.ndarray:
    """Weights by blendshape name; a name without its side stands for both."""
    return np.array([max(given.get(name, 0.0), given.get(name.removesuffix("Left").removesuffix("Right"), 0.0))
                     for name in names])  # fmt: skip


def residual(name: str, of: np.ndarray, context: TermContext | None = None, names=NAMES) -> np.ndarray:
    at = FaceParameters(np.zeros(3), np.zeros(3), of, np.zeros(0))
    return np.asarray(residual_of(name)(at, context or still(at)._replace(usual=usual_expressions(names))))


def cost(of: np.ndarray, name: str = "usual") -> float:
    return float(np.sum(residual(name, of) ** 2))


class TestSymmetry:
    def test_both_sides_of_a_pair_are_compared_and_nothing_else(self):
        assert cost(weights(mouthSmileLeft=0.7, mouthSmileRight=0.2, jawOpen=0.9), "symmetry") == pytest.approx(0.25)
        assert cost(weights(mouthSmile=0.7, eyeBlink=1.0, jawOpen=0.9), "symmetry") == 0.0

    def test_the_jaw_and_the_mouth_may_move_to_one_side_and_eyes_may_turn(self):
        names = load_default_head(gaze=True).expression_names
        for name in (*ONE_SIDED, *GAZE_NAMES):
            assert not residual("symmetry", weights(names, **{name: 1.0}), names=names).any()

    def test_every_other_blendshape_of_a_side_has_its_pair(self):
        sides = usual_expressions(NAMES).sides
        ends = [name.endswith(("Left", "Right")) and name not in ONE_SIDED for name in NAMES]
        np.testing.assert_array_equal(np.abs(sides).sum(axis=0), np.array(ends, float))
        np.testing.assert_array_equal(sides.sum(axis=1), 0.0)


class TestUsual:
    def test_it_is_the_weights_by_the_inverse_of_their_second_moment(self):
        moments = bundled_moments()
        rows = [moments.names.index(name) for name in NAMES]
        second = moments.second[np.ix_(rows, rows)] + LEAST_DEVIATION**2 * np.eye(len(NAMES))
        some = np.random.default_rng(0).uniform(0.0, 1.0, len(NAMES))
        assert cost(some) == pytest.approx(some @ np.linalg.solve(second, some), rel=1e-9)
        assert cost(np.zeros(len(NAMES))) == 0.0

    def test_what_acts_together_costs_less_than_each_alone(self):
        laugh = weights(**LAUGH)
        assert cost(laugh) < 0.5 * sum(
            cost(np.where(np.arange(len(laugh)) == k, laugh, 0.0)) for k in laugh.nonzero()[0]
        )
        one_sided = weights(**{f"{name}Left": value for name, value in LAUGH.items()})
        assert cost(laugh) < 1.2 * cost(one_sided)

    def test_how_eyes_turn_is_left_to_the_terms_of_the_gaze(self):
        names = load_default_head(gaze=True).expression_names
        assert not residual("usual", weights(names, eyeLookUp=1.0, eyeLookInLeft=0.5), names=names).any()

    def test_other_blendshapes_are_judged_by_what_is_known_of_them(self):
        names = ("jawOpen", "Brow_01", "mouthSmileLeft", "twistLeft", "twistRight")
        usual = usual_expressions(names)
        assert usual.whitening.shape == (2, 5)
        assert not usual.whitening[:, [1, 3, 4]].any()
        np.testing.assert_array_equal(usual.sides, [[0.0, 0.0, 0.0, 1.0, -1.0]])

    def test_components_without_names_are_not_judged_at_all(self, head):
        model = landmark_model(principal_expressions(head, 6))
        at = FaceParameters(np.zeros(3), np.zeros(3), np.ones(6), np.zeros(0))
        for name in ("symmetry", "usual"):
            assert residual_of(name)(at, still(at)._replace(usual=model.usual)).size == 0
            assert residual_of(name)(at, still(at)).size == 0


def naming(*terms: str, base: str = "joint", **omega: float) -> Config:
    """A preset whose last stage names terms."""
    config = preset(base)
    stages = [stage.model_dump() for stage in config.stages]
    stages[-1]["terms"] = (*stages[-1]["terms"], *terms)
    return config.changed(stages=stages, weights=omega, camera={"fov_deg": 45.0})


def fitted(head, config: Config, given: dict[str, float], noise_px: float, count: int = 6) -> np.ndarray:
    """Weights fitted to a face seen `count` times with noise."""
    fitter, found = FaceItFitter(head, plan_of(config)), []
    scene = make_scene(head, weights=given)
    for k in range(count):
        fit, _ = fitter.fit(scene.observation(k, noise_px), FrameContext(0, np.zeros(50), None, None))
        found.append(fit.expression)
    return np.array(found)


def both(**given: float) -> dict[str, float]:
    return {name: value for name, value in zip(NAMES, weights(**given), strict=True) if value}


class TestFits:
    @pytest.mark.long
    def test_noise_no_longer_makes_a_laugh_lopsided(self, head):
        sides = usual_expressions(NAMES).sides
        rough, even = (
            np.abs(fitted(head, config, both(**LAUGH), 1.0) @ sides.T).mean()
            for config in (naming(), naming("symmetry", symmetry=100.0))
        )
        assert even < 0.6 * rough

    def test_a_wink_stays_a_wink(self, head):
        left, right = (NAMES.index(f"eyeBlink{side}") for side in ("Left", "Right"))
        found = fitted(head, naming("symmetry", symmetry=20.0), {"eyeBlinkLeft": 1.0}, 0.3)
        assert found[:, left].min() > 0.75
        assert found[:, right].max() < 0.2

    def test_a_smile_brings_the_cheeks_that_landmarks_do_not_show(self, head):
        cheeks = [NAMES.index(f"cheekSquint{side}") for side in ("Left", "Right")]
        alone, usual = (
            fitted(head, config, both(**LAUGH), 0.5)[:, cheeks].mean()
            for config in (naming(sigma_smooth=20.0), naming("usual", usual=1.0, sigma_smooth=1.0))
        )
        assert usual > 0.15 > alone

    @pytest.mark.parametrize("name", ["symmetry", "usual"])
    def test_fits_that_do_not_name_it_are_the_same_whatever_its_weight(self, head, name):
        plain, weighed = (
            fitted(head, config, both(**LAUGH), 0.5, count=1) for config in (naming(), naming(**{name: 500.0}))
        )
        np.testing.assert_array_equal(plain, weighed)
        assert name in TABLE
        assert name not in FACE_IT_TERMS


class TestFiles:
    def test_the_bundled_moments_are_of_the_whole_head(self):
        moments = bundled_moments()
        assert moments.names == load_default_head(gaze=True).expression_names
        assert np.linalg.eigvalsh(moments.second).min() > -1e-6

    def test_what_is_written_is_read(self, tmp_path):
        moments = Moments(("a", "b"), np.array([[0.5, 0.25], [0.25, 1.0]]))
        write_moments(tmp_path / "m.safetensors", moments, {"licence": "mine"})
        read = read_moments(tmp_path / "m.safetensors")
        assert read.names == moments.names
        np.testing.assert_array_equal(read.second, moments.second)

    def test_a_damaged_file_says_how_to_make_it_again(self, tmp_path):
        path = tmp_path / "m.safetensors"
        path.write_bytes(b"no safetensors")
        with pytest.raises(ModelError, match=r"cannot be read as moments of expressions .*workbench train expressions"):
            read_moments(path)
        with pytest.raises(ModelError, match=r"absent\.safetensors does not exist"):
            read_moments(tmp_path / "absent.safetensors")

    def test_names_and_numbers_must_agree(self, tmp_path):
        path = tmp_path / "m.safetensors"
        save_file({"second": np.eye(3, dtype=np.float32)}, path, {"names": json.dumps(["a", "b"])})
        with pytest.raises(ModelError, match=r"for each of its names, got shape \(3, 3\) and 2 names"):
            read_moments(path)
        save_file({"other": np.eye(3, dtype=np.float32)}, path)
        with pytest.raises(ModelError, match=r"got shape \(0, 0\) and 0 names"):
            read_moments(path)
