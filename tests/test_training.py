"""Training the networks: pictures show what their landmarks say, and the same seed gives the same weights."""

from dataclasses import replace

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
import torch

from workbench.errors import InputError
from workbench.landmarks.alignment import MEAN_SHAPE, frame_from_points
from workbench.landmarks.network_detector import crop_frame
from workbench.landmarks.scheme import MIRROR
from workbench.networks import read_landmark_network, soft_argmax
from workbench.networks.face_finder import UNIT_SIDE, boxes_of
from workbench.networks.landmark_network import empty_landmark_network
from workbench.networks.weights import fill, read_weights
from workbench.pictures.gl_probe import gl_available
from workbench.training.augment import Hardness, augmented
from workbench.training.evaluation import (
    Answers,
    calibration_of,
    error_table,
    eye_aspect,
    mouth_opening,
    rank_correlation,
    reliability,
)
from workbench.training.finder_task import FinderTask, crowd
from workbench.training.landmark_task import LandmarkTask, local_soft_argmax, loss_of, target_distribution
from workbench.training.loop import Phase, TrainingPlan, folded_arrays, train
from workbench.training.pool import SHARD, Pool, open_pool, shard_paths
from workbench.training.scenes import FaceStudio, random_expression, random_pose_deg
from workbench.training.skin import skin_painter
from workbench.training.torch_network import TorchLandmarkNetwork

SIDE = 96
"""Pixels of the renders in the made-up pool."""
PLAN = TrainingPlan(phases=(Phase(32, 4, 3, 1e-3), Phase(64, 2, 2, 1e-3)), widths=(4, 4, 6, 6), blocks=1)


@pytest.fixture(scope="module")
def pool_folder(tmp_path_factory):
    """A pool of grey discs with a dot at each landmark of a face that stands upright, in three sizes."""
    folder = tmp_path_factory.mktemp("pool")
    pictures = np.zeros((SHARD, SIDE, SIDE, 4), np.uint8)
    landmarks = np.zeros((SHARD, 68, 2), np.float32)
    for k in range(SHARD):
        middle, side = np.array([SIDE / 2, SIDE / 2]) + (k % 5 - 2), (36, 42, 48)[k % 3]
        landmarks[k] = MEAN_SHAPE * side + middle
        cv2.circle(pictures[k], tuple(np.rint(middle).astype(int).tolist()), side, (120, 110, 100, 255), -1)
        for x, y in np.rint(landmarks[k]).astype(int):
            pictures[k, y, x, :3] = 255
    pictures_path, numbers_path = shard_paths(folder, 0)
    np.save(pictures_path, pictures)
    np.savez(numbers_path, landmarks=landmarks, angles=np.zeros((SHARD, 3)), expressions=np.zeros((SHARD, 52)))
    return folder


@pytest.fixture(scope="module")
def pool(pool_folder) -> Pool:
    return open_pool(pool_folder)


def quiet(_line: str) -> None:
    """No report."""


def answers(errors_percent, mass, truth=None) -> Answers:
    """Answers whose errors to the right are these, in percent of the outer-eye distance."""
    truth = np.tile(MEAN_SHAPE * 100, (len(errors_percent), 1, 1)) if truth is None else truth
    unit = np.linalg.norm(truth[:, 45] - truth[:, 36], axis=-1)[:, None]
    points = truth.copy()
    points[..., 0] += np.asarray(errors_percent) / 100 * unit
    return Answers(points, np.asarray(mass, float), truth, np.zeros((len(truth), 3)))


@pytest.fixture(scope="module")
def studio(head):
    if not gl_available():
        pytest.skip("VTK finds no OpenGL here")
    made = FaceStudio(head, skin_painter(head))
    yield made
    made.close()


class TestRenders:
    def test_the_same_seed_gives_the_same_picture_and_another_seed_another_person(self, studio):
        shots = []
        for seed in (1, 1, 2):
            rng = np.random.default_rng(seed)
            shots.append(studio.shoot(studio.cast(rng), rng))
        assert np.array_equal(shots[0].rgba, shots[1].rgba)
        assert np.array_equal(shots[0].landmarks, shots[1].landmarks)
        assert not np.array_equal(shots[0].rgba, shots[2].rgba)

    def test_landmarks_lie_on_the_head_and_fill_the_middle_of_the_picture(self, studio):
        for seed in range(6):
            rng = np.random.default_rng(seed)
            shot = studio.shoot(studio.cast(rng), rng)
            face = frame_from_points(shot.landmarks)
            assert face.side == pytest.approx(320 / 2.2, rel=0.02)
            assert face.origin == pytest.approx(np.full(2, 159.5), abs=3)
            covered = cv2.dilate(shot.rgba[..., 3], np.ones((5, 5), np.uint8))
            inner = np.clip(np.rint(shot.landmarks[17:]).astype(int), 0, 319)
            assert (covered[inner[:, 1], inner[:, 0]] > 0).mean() > 0.95

    def test_poses_and_expressions_stay_in_range_and_close_the_eyes_now_and_then(self, head):
        rng = np.random.default_rng(0)
        poses = np.array([random_pose_deg(rng) for _ in range(500)])
        assert np.abs(poses).max(axis=0) == pytest.approx([65, 35, 20], abs=6)
        weights = np.array([random_expression(head.expression_names, rng) for _ in range(500)])
        assert weights.min() >= 0
        assert weights.max() <= 1
        assert np.mean(weights[:, head.expression_names.index("eyeBlinkLeft")] > 0.8) > 0.05
        assert np.mean(weights[:, head.expression_names.index("jawOpen")] > 0.5) > 0.05


class TestAugmentation:
    def test_the_dots_of_the_render_stay_under_the_landmarks(self, pool):
        """However the picture is framed, turned and mirrored: brightness at the landmarks, not elsewhere."""
        for index in range(8):
            made = augmented(pool, index, np.random.default_rng(index), 256, Hardness(1.0, 0.0, 0.0))
            inside = made.landmarks[((made.landmarks > 3) & (made.landmarks < 252)).all(axis=1)]
            places = np.rint(inside).astype(int)
            blurred = cv2.blur(made.picture.max(axis=-1).astype(np.float32), (3, 3))
            at = blurred[places[:, 1], places[:, 0]].mean()
            beside = blurred[places[:, 1] - 6, places[:, 0] + 5].mean()
            assert at > beside + 15

    def test_without_hardness_the_crop_is_the_detectors(self, pool):
        made = augmented(pool, 0, np.random.default_rng(3), 256, Hardness(0.0, 0.0, 0.0))
        _, points = pool.picture(0)
        view = crop_frame(frame_from_points(points.astype(float)))
        expected = view.to_face(points.astype(float))
        mirrored = expected[list(MIRROR)] * [-1, 1] + [255, 0]
        closest = min(np.abs(made.landmarks - expected).max(), np.abs(made.landmarks - mirrored).max())
        assert closest < 0.5

    def test_pictures_without_a_face_occur_and_say_so(self, pool):
        faces = [augmented(pool, k % SHARD, np.random.default_rng(k), 32).is_face for k in range(300)]
        assert 0.9 < np.mean(faces) < 0.99

    def test_the_same_seed_gives_the_same_picture(self, pool):
        first, second = (augmented(pool, 5, np.random.default_rng(9), 64) for _ in range(2))
        assert np.array_equal(first.picture, second.picture)


class TestLandmarkTask:
    def test_the_target_has_the_landmark_as_its_mean_place(self):
        points = torch.tensor([[[3.25, 7.5], [10.0, 2.0]]])
        target = target_distribution(points, 16).view(1, 2, 16, 16)
        at = torch.arange(16.0)
        assert torch.allclose(target.sum((2, 3)), torch.ones(1, 2))
        assert torch.allclose((target.sum(2) * at).sum(-1), points[..., 0])
        assert torch.allclose((target.sum(3) * at).sum(-1), points[..., 1])

    def test_points_outside_of_the_map_have_no_target(self):
        assert float(target_distribution(torch.tensor([[[-2.0, 5.0], [5.0, 16.0]]]), 16).sum()) == 0.0

    def test_a_perfect_answer_is_read_back_and_costs_least(self):
        points = torch.rand(2, 68, 2) * 10 + 2
        target = target_distribution(points, 16).view(2, 68, 16, 16)
        perfect = torch.log(target.clamp_min(1e-12))
        assert torch.allclose(local_soft_argmax(perfect), points, atol=1e-3)
        face = torch.ones(2)
        good, numbers = loss_of(perfect, points, face)
        assert numbers["inner_percent"] < 0.5
        assert good < loss_of(torch.zeros_like(perfect), points, face)[0]

    def test_the_soft_argmax_is_the_one_that_runs(self):
        """Also at the border, where part of the patch is missing."""
        maps = torch.randn(1, 68, 16, 16, generator=torch.Generator().manual_seed(1)) * 3
        ours = np.asarray(soft_argmax(jnp.asarray(maps[0].numpy()), 1.0))
        assert np.abs(local_soft_argmax(maps)[0].numpy() - ours).max() < 1e-4

    def test_no_face_wants_an_even_map(self):
        maps = torch.randn(1, 68, 8, 8)
        even, _ = loss_of(torch.zeros_like(maps), torch.zeros(1, 68, 2) + 4, torch.zeros(1))
        sure, _ = loss_of(20 * maps, torch.zeros(1, 68, 2) + 4, torch.zeros(1))
        assert even < sure


class TestFinderTask:
    def maps_of(self, boxes) -> np.ndarray:
        """What a perfect finder says of boxes (x, y, side) in pixels of a 256×256 picture."""
        maps = np.zeros((4, 64, 64), np.float32)
        maps[0] = -9
        for x, y, side in boxes:
            column, row = round((x + 0.5) / 4 - 0.5), round((y + 0.5) / 4 - 0.5)
            maps[0, row, column] = 9
            maps[1, row, column] = np.log(side / UNIT_SIDE)
            maps[2:, row, column] = (x - 4 * column - 1.5) / UNIT_SIDE, (y - 4 * row - 1.5) / UNIT_SIDE
        return maps

    def test_boxes_come_back_from_perfect_maps(self):
        boxes = [(60.0, 80.5, 40.0), (200.25, 130.0, 90.0)]
        found = [np.array(box) for box, _ in boxes_of(self.maps_of(boxes), 0.5)]
        for x, y, side in boxes:
            assert any(
                np.allclose(box, [x - side / 2, y - side / 2, x + side / 2, y + side / 2], atol=1e-3) for box in found
            )
        assert len(found) == 2

    def test_perfect_maps_cost_less_than_wrong_ones(self):
        boxes = [(60.0, 80.5, 40.0)]
        targets = (torch.tensor([[*boxes, (0, 0, 0), (0, 0, 0), (0, 0, 0)]]),)
        perfect = torch.from_numpy(self.maps_of(boxes))[None]
        elsewhere = torch.from_numpy(self.maps_of([(160.0, 180.0, 40.0)]))[None]
        task = FinderTask()
        assert task.loss(perfect, targets)[0] < task.loss(torch.zeros_like(perfect), targets)[0]
        assert task.loss(perfect, targets)[0] < task.loss(elsewhere, targets)[0]

    def test_crowds_have_boxes_inside_and_sometimes_none(self, pool):
        counts = []
        for seed in range(40):
            picture, boxes = crowd(pool, np.random.default_rng(seed), 64)
            there = boxes[boxes[:, 2] > 0]
            assert picture.shape == (64, 64, 3)
            assert ((there[:, :2] > 0) & (there[:, :2] < 63)).all()
            counts.append(len(there))
        assert min(counts) == 0
        assert max(counts) >= 2


class TestLoop:
    def test_an_interrupted_training_ends_with_the_same_weights(self, pool_folder, tmp_path, monkeypatch):
        whole = train(LandmarkTask(), pool_folder, tmp_path / "whole", PLAN, 0, every=2, report=quiet)
        batch = LandmarkTask.batch

        def interrupted(task, pool, phase, rngs):
            if phase.input_side == 64:
                raise KeyboardInterrupt
            return batch(task, pool, phase, rngs)

        monkeypatch.setattr(LandmarkTask, "batch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(LandmarkTask(), pool_folder, tmp_path / "parts", PLAN, 0, every=2, report=quiet)
        monkeypatch.undo()
        lines = []
        resumed = train(LandmarkTask(), pool_folder, tmp_path / "parts", PLAN, 0, every=2, report=lines.append)
        assert [line for line in lines if line.startswith("step 6 of 6")] == lines
        first, second = read_weights(whole).arrays, read_weights(resumed).arrays
        assert max(np.abs(first[name] - second[name]).max() for name in first) < 1e-5

    def test_a_folder_of_another_plan_is_refused(self, pool_folder, tmp_path):
        train(LandmarkTask(), pool_folder, tmp_path, PLAN, workers=0, report=quiet)
        with pytest.raises(InputError, match="another plan"):
            train(LandmarkTask(), pool_folder, tmp_path, replace(PLAN, seed=2), workers=0, report=quiet)

    def test_no_pool_is_a_clear_error(self, tmp_path):
        with pytest.raises(InputError, match="no pool of rendered heads"):
            open_pool(tmp_path)

    def test_the_rate_rises_then_falls_in_each_phase(self):
        plan = TrainingPlan(phases=(Phase(128, 1000, 8, 1e-3), Phase(256, 500, 8, 1e-4)))
        rates = [plan.rate(step) for step in range(plan.steps)]
        assert max(rates[:1000]) == pytest.approx(1e-3, rel=0.05)
        assert max(rates[1000:]) == pytest.approx(1e-4, rel=0.05)
        assert rates[0] < 0.1 * max(rates)
        assert rates[999] < 0.03e-3

    def test_the_kept_network_says_what_the_trained_one_says(self, tmp_path, pool_folder):
        """PyTorch with batch normalisation, and JAX with it folded away."""
        torch.manual_seed(0)
        network = TorchLandmarkNetwork((4, 4, 6, 6), 1, 68)
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.normal_()
                module.running_var.uniform_(0.5, 2.0)
                module.weight.data.uniform_(0.5, 1.5)
                module.bias.data.normal_()
        network.eval()
        picture = torch.rand(1, 3, 64, 64)
        with torch.no_grad():
            expected = network(picture)[0].numpy()
        path = train(LandmarkTask(), pool_folder, tmp_path, PLAN, workers=0, report=quiet)
        weights = read_weights(path)
        weights = replace(weights, arrays=folded_arrays(network, 1 / 50))
        ours = fill(lambda: empty_landmark_network((4, 4, 6, 6), 1), weights)
        assert np.abs(50 * np.asarray(ours(jnp.asarray(picture[0].numpy()))) - expected).max() < 1e-4
        assert read_landmark_network(path).widths == (4, 4, 6, 6)


class TestEvaluation:
    def test_errors_are_told_by_yaw_and_group(self):
        made = answers(np.full((3, 68), 4.0), np.ones((3, 68)))
        made = replace(made, angles_deg=np.array([[0.0, 0, 0], [20.0, 0, 0], [50.0, 0, 0]]))
        table = error_table(made)
        assert table["inner 51, yaw below 45°"]["mean"] == pytest.approx(4.0)
        assert np.isnan(table["inner 51, yaw 30–45°"]["mean"])

    def test_calibration_never_falls_and_tells_how_often_landmarks_are_found(self):
        rng = np.random.default_rng(0)
        mass = rng.uniform(0, 1, (400, 68))
        found = rng.uniform(0, 1, mass.shape) < mass**2
        knots, confidence = calibration_of(answers(np.where(found, 1.0, 20.0), mass))
        assert (np.diff(knots) > 0).all()
        assert (np.diff(confidence) >= 0).all()
        assert confidence == pytest.approx(knots**2, abs=0.05)

    def test_reliability_of_honest_confidence_lies_on_the_diagonal(self):
        rng = np.random.default_rng(1)
        told = rng.uniform(0, 1, 40000)
        table = reliability(told, rng.uniform(0, 1, told.shape) < told)
        assert table[:, 0] == pytest.approx(table[:, 1], abs=0.03)
        assert table[:, 2].sum() == len(told)

    def test_confidence_that_follows_the_error_correlates(self):
        errors = np.random.default_rng(2).uniform(0, 10, (20, 68))
        assert rank_correlation(answers(errors, 1 / (1 + errors))) == pytest.approx(1.0)

    def test_eyes_and_mouth_are_measured_as_ratios(self):
        shape = MEAN_SHAPE.copy()
        assert eye_aspect(shape) == pytest.approx(eye_aspect(3 * shape + 5))
        closed = shape.copy()
        closed[[37, 38, 43, 44], 1] = closed[[41, 40, 47, 46], 1]
        assert eye_aspect(closed) < 0.3 * eye_aspect(shape)
        opened = shape.copy()
        opened[66, 1] += 0.2
        assert mouth_opening(opened) > mouth_opening(shape) + 0.3
