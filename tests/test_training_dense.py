"""The dense points and the training of their network: the rule, the likelihood, the calibration."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.distance import pdist, squareform

from workbench.errors import ModelError
from workbench.landmarks.network_detector import BUNDLED
from workbench.landmarks.scheme import MIRROR
from workbench.landmarks.schemes import DENSE_TABLE, DensePoints
from workbench.landmarks.uncertainty import ellipse_radius
from workbench.networks.dense_gain import MOST_PX, DenseGain, read_dense_gain
from workbench.networks.dense_network import read_dense_network
from workbench.networks.eye_network import SIDE as EYE_SIDE
from workbench.networks.eye_network import read_eye_network
from workbench.networks.frozen import FrozenDenseNetwork, FrozenEyeNetwork
from workbench.networks.regression import Places, places_of
from workbench.training.augment import TRAINING, augmented
from workbench.training.batch_studio import BatchStudio, Props
from workbench.training.contact_sheet import eye_samples
from workbench.training.dense_gain import corrected_answers, fitted_gain, write_dense_gain
from workbench.training.dense_measuring import ELLIPSES, DenseAnswers, deviation_factor, even_factor, measured_dense
from workbench.training.dense_points import IRIS_POINTS, SPACING_MM, dense_points, write_table
from workbench.training.dense_task import SIDE, DenseTask, loss_of
from workbench.training.evaluation import Answers
from workbench.training.eye_measuring import EyeAnswers, measured_eyes
from workbench.training.eye_pictures import eye_picture, moved, pupil_seen
from workbench.training.eye_task import EyeTask
from workbench.training.loop import Phase, TrainingPlan, train
from workbench.training.pool import SHARD, halves, open_pool, shard_paths

SMALL = TrainingPlan(phases=(Phase(SIDE, 3, 2, 1e-3),), widths=(4, 4, 6, 6), blocks=1)


@pytest.fixture(scope="module")
def points(gazing_head):
    return dense_points(gazing_head)


@pytest.fixture(scope="module")
def gazing_head():
    from workbench.face import load_default_head

    return load_default_head(gaze=True)


@pytest.fixture(scope="module")
def pool(pool_path):
    return open_pool(pool_path)


@pytest.fixture(scope="module")
def pool_path(gazing_head, tmp_path_factory):
    """The head's vertices from the front, on nothing."""
    folder = tmp_path_factory.mktemp("pool")
    side = 320
    vertices = gazing_head.neutral[:, :2] * 0.9 + side / 2
    landmarks = np.einsum("lkc,lk->lc", vertices[gazing_head.landmarks.vertices], gazing_head.landmarks.barycentric)
    every = np.concatenate([landmarks, [landmarks[36:42].mean(axis=0), landmarks[42:48].mean(axis=0)]])
    pictures_path, numbers_path = shard_paths(folder, 0)
    np.save(pictures_path, np.full((SHARD, side, side, 4), 200, np.uint8))
    np.savez(
        numbers_path,
        points=np.broadcast_to(every, (SHARD, 70, 2)).astype(np.float32),
        vertices=np.broadcast_to(vertices, (SHARD, *vertices.shape)).astype(np.float32),
        angles=np.zeros((SHARD, 3)),
        expressions=np.zeros((SHARD, 52)),
        glasses=np.zeros(SHARD, bool),
    )
    return folder


class TestPoints:
    def test_there_are_some_320_of_every_part_and_as_many_left_as_right(self, points, gazing_head):
        assert 300 <= len(points) <= 360
        counts = Counter(points.parts)
        assert set(counts) == {*SPACING_MM, "irises"}
        assert counts["irises"] == 2 * IRIS_POINTS
        assert counts["eyes"] > 40
        assert counts["mouth"] > 40
        assert np.array_equal(points.mirror[points.mirror], np.arange(len(points)))
        places = gazing_head.neutral[points.vertices]
        np.testing.assert_allclose(places[points.mirror], places * [-1, 1, 1], atol=0.1)

    def test_neighbours_keep_the_distance_of_their_part_and_nothing_is_left_bare(self, points, gazing_head):
        skin = [k for k, group in enumerate(points.parts) if group != "irises"]
        apart = squareform(pdist(gazing_head.neutral[points.vertices[skin]]))
        np.fill_diagonal(apart, np.inf)
        spacing = np.array([SPACING_MM[points.parts[k]] for k in skin])
        # A point that was taken for its partner's sake may lie closer.
        assert (apart.min(axis=1) >= spacing.min()).all()
        assert (apart.min(axis=1) <= 2.5 * spacing).mean() > 0.95

    def test_the_rule_gives_the_same_points_again(self, points, gazing_head):
        assert np.array_equal(dense_points(gazing_head).vertices, points.vertices)

    def test_the_scheme_holds_what_the_rule_chooses(self, points, tmp_path):
        write_table(points, tmp_path / "table.json")
        assert (tmp_path / "table.json").read_text() == DENSE_TABLE.read_text()


class TestPictures:
    def test_the_points_stay_on_the_face_whatever_the_crop(self, pool, points):
        """Mirrored or not, turned, larger: the similarity that takes the landmarks there takes the dense points."""
        index = 0
        _, landmarks = pool.picture(index)
        before = np.concatenate([landmarks, pool.surface(index, points.vertices)]).astype(float)
        for seed in range(6):
            made = augmented(pool, index, np.random.default_rng(seed), SIDE, TRAINING, points)
            after = np.concatenate([made.points, made.dense]).astype(float)
            ratio = pdist(after) / np.maximum(pdist(before), 1e-6)
            assert np.ptp(ratio[pdist(before) > 20]) / ratio[pdist(before) > 20].mean() < 0.05

    def test_in_whole_batches_they_do_too(self, pool, points):
        _, landmarks = pool.picture(0)
        before = pdist(np.concatenate([landmarks, pool.surface(0, points.vertices)]).astype(float))
        studio = BatchStudio(pool, SIDE, points, props=Props(1, 1, 1))
        _, (placed, _) = studio.shoot(6, seed=1)
        for after in placed.numpy().astype(float):
            ratio = (pdist(after) / np.maximum(before, 1e-6))[before > 20]
            assert np.ptp(ratio) / ratio.mean() < 0.05

    def test_without_being_asked_there_are_none(self, pool):
        assert augmented(pool, 0, np.random.default_rng(0)).dense.shape == (0, 2)

    def test_halves_share_nobody_unless_there_is_one_shard(self, pool):
        first, second = halves(pool)
        assert len(first) == len(second) == SHARD


class TestLikelihood:
    def test_the_true_place_and_the_true_deviation_cost_least(self):
        rng = np.random.default_rng(0)
        deviation = 3.0
        truth = torch.tensor(rng.uniform(60, 190, (400, 70, 2)), dtype=torch.float32)
        read = truth + torch.tensor(rng.normal(0, deviation, truth.shape), dtype=torch.float32)
        share = (read + 0.5) / SIDE - 0.5

        def cost(places, sigma):
            logs = torch.full_like(places, -np.log(sigma))
            numbers = torch.cat([places, logs, torch.zeros_like(places[..., :1])], dim=-1)
            return float(loss_of(numbers, truth, torch.ones(400))[0])

        assert cost(share, deviation) < min(cost(share, 0.6 * deviation), cost(share, 1.8 * deviation))
        assert cost(share, deviation) < cost(share + 4 / SIDE, deviation)

    def test_pictures_without_a_face_teach_no_places(self):
        numbers = torch.zeros(2, 70, 5, requires_grad=True)
        loss_of(numbers, torch.full((2, 70, 2), 99.0), torch.tensor([1.0, 0.0]))[0].backward()
        assert numbers.grad[0].abs().max() > 0
        assert numbers.grad[1].abs().max() == 0


@pytest.fixture(scope="module")
def answers():
    """Gaussian errors of 2 px, of which the network claims 1; one head in four is turned away."""
    rng = np.random.default_rng(1)
    truth = np.tile(rng.uniform(0, 200, (1, 90, 2)), (4000, 1, 1))
    truth[:, 36], truth[:, 45] = (50, 100), (150, 100)
    points = truth + rng.normal(0, 2.0, truth.shape)
    angles = np.where(np.arange(4000)[:, None] % 4 == 0, [60.0, 0.0, 0.0], 0.0)
    return DenseAnswers(points, truth, angles, np.broadcast_to(np.eye(2), (*truth.shape[:2], 2, 2)))


class TestCalibration:
    def test_the_factor_is_what_the_claims_lack(self, answers):
        np.testing.assert_allclose(deviation_factor(answers.deviations), 2.0, rtol=0.06)

    def test_honest_ellipses_hold_their_share(self, answers):
        honest = DenseAnswers(answers.points, answers.truth, answers.angles_deg, answers.whitening / 2.0)
        for share in ELLIPSES:
            assert (honest.deviations < ellipse_radius(share)).mean() == pytest.approx(share, abs=0.01)

    def test_the_tables_tell_errors_and_shares_by_part(self, answers):
        dense = DensePoints(np.arange(20), np.arange(20), (*["nose"] * 12, *["irises"] * 8), ("middle",) * 20)
        rows = measured_dense(answers, answers, dense)
        assert list(rows) == ["68 landmarks, without the jaw", "pupils", "dense, nose", "dense, irises"]
        assert rows["dense, nose"]["clean"] == pytest.approx(2.0 * np.sqrt(np.pi / 2), rel=0.02)
        assert rows["pupils"]["damaged, inside 50%"] == pytest.approx(1 - np.exp(-1.386 / 8), abs=0.02)


def looked_at(seed):
    """Answers on 700 pictures: dense errors are half of what is missed at the 68, and a little chance."""
    rng, truth = np.random.default_rng(seed), np.tile(np.random.default_rng(3).uniform(40, 200, (377, 2)), (700, 1, 1))
    shared = rng.normal(0, 6.0, (700, 307, 2))
    points = truth + rng.normal(0, 0.3, truth.shape)
    points[:, 70:] -= 0.5 * shared
    points[:, :68] -= shared[:, :68]
    whitening = np.broadcast_to(np.eye(2), (*truth.shape[:2], 2, 2))
    heat_maps = truth[:, :68] + rng.normal(0, 0.3, (700, 68, 2))
    angles = np.zeros((700, 3))
    return (
        DenseAnswers(points, truth, angles, whitening),
        Answers(heat_maps, truth[:, :68], angles, np.ones((700, 68))),
    )


def test_ellipses_are_scaled_for_the_worst_of_several_kinds_of_pictures():
    """Deviations of one and of one and a half claimed ones: between the two, what each ellipse misses is alike."""
    normal = np.random.default_rng(0).normal(size=(2, 20000, 1, 2))
    kinds = [spread * np.linalg.norm(draws, axis=-1) for spread, draws in zip((1.0, 1.5), normal, strict=True)]
    (factor,) = even_factor(kinds)
    assert 1.0 < factor < 1.5
    too_many, too_few = (
        max(sign * ((found < factor * ellipse_radius(share)).mean() - share) for share in ELLIPSES)
        for sign, found in zip((1.0, -1.0), kinds, strict=True)
    )
    assert too_many == pytest.approx(too_few, abs=0.01)
    assert even_factor(kinds[:1]) == pytest.approx(1.0, rel=0.03)


class TestGain:
    def test_what_the_heat_maps_tell_of_other_points_is_learned(self):
        # Each of the first 68 further points errs with a landmark: mirrored, it has to err with the mirrored one.
        order = tuple(np.array([*MIRROR, *range(68, 307)]).tolist())
        points = DensePoints(np.arange(307), np.array(order), ("face",) * 307, ("middle",) * 307)
        gain, (dense, heat_maps) = fitted_gain([[looked_at(seed)] for seed in range(3)], points), looked_at(3)
        corrected = corrected_answers(gain, dense, heat_maps)
        before, after = (np.linalg.norm(each.truth - each.points, axis=-1) for each in (dense, corrected))
        assert after[:, 70:138].mean() < 0.35 * before[:, 70:138].mean()
        assert np.array_equal(after[:, :70], before[:, :70])
        assert after[:, 138:].mean() == pytest.approx(before[:, 138:].mean(), rel=0.05)
        for share in ELLIPSES:
            held = (corrected.deviations[:, 70:] < ellipse_radius(share)).mean()
            assert held == pytest.approx(share, abs=0.03)

    def test_a_network_that_is_lost_moves_the_points_by_a_bounded_way(self):
        gain = DenseGain(np.full((614, 136), 0.01), np.full(307, 2.0))
        dense, _ = looked_at(0)
        seen = Places(dense.points[0], dense.whitening[0])
        far, farther = (gain.corrected(seen, seen.points[:68] + away) for away in (MOST_PX, 50 * MOST_PX))
        assert np.array_equal(far.points, farther.points)
        assert far.points[70:] == pytest.approx(seen.points[70:] + 136 * 0.01 * MOST_PX)
        assert far.whitening[70:] == pytest.approx(seen.whitening[70:] / 2)
        assert np.array_equal(far.whitening[:70], seen.whitening[:70])

    def test_a_file_gives_the_gain_back_and_other_weights_are_refused(self, tmp_path):
        rng = np.random.default_rng(4)
        gain = DenseGain(rng.normal(size=(614, 136)), rng.uniform(0.5, 1.0, 307))
        write_dense_gain(tmp_path / "gain.safetensors", gain)
        back = read_dense_gain(tmp_path / "gain.safetensors")
        np.testing.assert_allclose(back.gain, gain.gain, atol=2e-3)
        np.testing.assert_allclose(back.deviation_factor, gain.deviation_factor, rtol=1e-6)
        with pytest.raises(ModelError, match="should hold a face-energy-dense-gain-1"):
            read_dense_gain(BUNDLED / "eyes.safetensors")


class TestEyes:
    def test_a_contact_sheet_shows_eyes_with_pupil_and_iris(self, pool_path):
        shapes = {(sample.picture.shape, sample.points.shape) for sample in eye_samples(pool_path)}
        assert shapes == {((EYE_SIDE, EYE_SIDE, 3), (9, 2))}

    def test_the_points_of_a_crop_are_those_of_the_render_as_a_right_eye_s(self, pool):
        """The made-up pool is symmetric, so a left eye's crop, which comes mirrored, says what a right one's does."""
        shapes = []
        for eye in (0, 1):
            for seed in range(3):
                made = eye_picture(pool, 0, eye, np.random.default_rng(seed))
                assert made.picture.shape == (EYE_SIDE, EYE_SIDE, 3)
                shapes.append(pdist(made.points))
        for shape in shapes:
            ratio = shape / shapes[0]
            assert np.ptp(ratio) / ratio.mean() < 0.05

    def test_moving_a_crop_moves_its_points(self, pool):
        made = eye_picture(pool, 0, 0, np.random.default_rng(0))
        aside = moved(made, np.random.default_rng(4))
        shift = np.unique(aside.points - made.points, axis=0)
        assert len(np.unique(np.round(shift, 9), axis=0)) == 1
        assert np.abs(shift).max() <= 3

    def test_a_pupil_behind_the_lids_is_not_seen(self):
        lids = np.array([[0, 5], [3, 2], [7, 2], [10, 5], [7, 8], [3, 8]], float)
        assert pupil_seen(lids, np.array([5.0, 5.0]))
        assert not pupil_seen(lids, np.array([5.0, 9.0]))

    def test_what_is_kept_says_what_was_trained_and_goes_on(self, pool_path, tmp_path):
        plan = TrainingPlan(phases=(Phase(EYE_SIDE, 3, 2, 1e-3),), widths=SMALL.widths, blocks=1)
        kept = train(EyeTask(), pool_path, tmp_path / "eyes", plan, workers=0, report=lambda _: None)
        still = TrainingPlan(phases=(Phase(EYE_SIDE, 1, 8, 1e-9),), widths=SMALL.widths, blocks=1)
        on = train(EyeTask(), pool_path, tmp_path / "on", still, workers=0, report=lambda _: None, start=kept)
        picture = np.random.default_rng(5).integers(0, 256, (EYE_SIDE, EYE_SIDE, 3), dtype=np.uint8)
        first, second = (FrozenEyeNetwork(read_eye_network(path))(picture) for path in (kept, on))
        np.testing.assert_allclose(first.points, second.points, atol=0.5)

    def test_the_tables_tell_errors_slope_and_shares_with_and_without_glasses(self):
        rng = np.random.default_rng(2)
        truth = 32.0 + 6.0 * rng.normal(size=(4000, 9, 2))
        points = truth + rng.normal(0, 1.0, truth.shape)
        whitening = np.broadcast_to(np.eye(2), (4000, 9, 2, 2))
        glasses, is_open = np.arange(4000) % 2.0, np.ones(4000)
        answers = EyeAnswers(points, whitening, 0.9 * is_open, truth, is_open, glasses, np.zeros(4000))
        tables = measured_eyes(answers, answers)
        assert list(tables) == [
            f"{kind}, {name}" for kind in ("clean", "damaged") for name in ("without glasses", "with glasses")
        ]
        row = tables["clean, with glasses"]
        assert row["pupil: mean"] == pytest.approx(100 * np.sqrt(np.pi / 2) / (0.6 * EYE_SIDE), rel=0.05)
        assert row["slope"] == pytest.approx(1.0, abs=0.02)
        assert row["inside 80%"] == pytest.approx(0.8, abs=0.02)
        assert row["open or shut: right"] == 1.0
        # Of shut eyes, which are far off here, nothing counts but that they are shut.
        shut = rng.random(4000) < 0.5
        lost = replace(answers, points=points + 50.0 * shut[:, None, None], is_open=1.0 - shut)
        row = measured_eyes(lost, lost)["clean, with glasses"]
        assert row["inside 80%"] == pytest.approx(0.8, abs=0.03)
        assert row["open or shut: right"] == pytest.approx(0.5, abs=0.05)


class TestTraining:
    def test_what_is_kept_says_what_was_trained(self, pool_path, tmp_path):
        task = DenseTask()
        kept = train(task, pool_path, tmp_path / "dense", SMALL, workers=0, report=lambda _: None)
        network = task.network(SMALL).eval()
        state = torch.load(tmp_path / "dense" / "checkpoint.pt", map_location="cpu", weights_only=True)
        network.load_state_dict(state["average"])
        picture = np.random.default_rng(5).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
        with torch.no_grad():
            numbers = network(torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255)[0].numpy().ravel()
        expected, found = places_of(numbers, SIDE), FrozenDenseNetwork(read_dense_network(kept))(picture)
        np.testing.assert_allclose(found.points, expected.points, atol=1e-2)
        np.testing.assert_allclose(found.whitening, expected.whitening, rtol=1e-3, atol=1e-4)

    def test_a_training_goes_on_from_a_dense_network(self, pool_path, tmp_path):
        """One step at a rate of next to nothing leaves what it answers as it was."""
        kept = train(DenseTask(), pool_path, tmp_path / "dense", SMALL, workers=0, report=lambda _: None)
        still = replace(SMALL, phases=(Phase(SIDE, 1, 4, 1e-9),))
        on = train(DenseTask(), pool_path, tmp_path / "on", still, workers=0, report=lambda _: None, start=kept)
        picture = np.random.default_rng(5).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
        first, second = (FrozenDenseNetwork(read_dense_network(path))(picture) for path in (kept, on))
        np.testing.assert_allclose(first.points, second.points, atol=2.0)
