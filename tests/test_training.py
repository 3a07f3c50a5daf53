"""Training the networks: pictures show what their landmarks say, and the same seed gives the same weights."""

import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
import torch

from tests.dotted_pool import write_dotted_pool, write_window
from tests.small_disk import small_disk
from workbench.cli.training import RESULTS, Network
from workbench.errors import InputError, OutputError
from workbench.face import load_default_head
from workbench.face.dense_landmarks import pupil_vertices
from workbench.landmarks.alignment import MEAN_SHAPE, frame_from_points
from workbench.landmarks.lids import lid_openings
from workbench.landmarks.network_detector import crop_frame
from workbench.landmarks.scheme import MIRROR
from workbench.networks import read_landmark_network, soft_argmax
from workbench.networks.face_finder import UNIT_SIDE, boxes_of
from workbench.networks.landmark_network import NAME, empty_landmark_network
from workbench.networks.weights import fill, read_weights, write_weights
from workbench.pictures.gl_probe import WINDOW_VARIABLE, _working_window, gl_available
from workbench.pictures.lighting import Light, Lighting
from workbench.training import PLAN_FILE, loop
from workbench.training.augment import Hardness, augmented, cut_out
from workbench.training.brows import BrowPlace, brow_landmarks, brows_at, denser, random_brow_place
from workbench.training.dense_task import DenseTask
from workbench.training.evaluation import (
    Answers,
    calibration_of,
    error_table,
    eye_aspect,
    mouth_opening,
    rank_correlation,
    reliability,
)
from workbench.training.eye_task import EyeTask
from workbench.training.finder_task import FinderTask, can_be_seen, crowd
from workbench.training.landmark_task import LandmarkTask, local_soft_argmax, loss_of, target_distribution
from workbench.training.loop import Phase, TrainingPlan, checked_plan, export_weights, folded_arrays, train
from workbench.training.measuring import lids_of
from workbench.training.pool import SHARD, Pool, make_shards, open_pool, shard_paths
from workbench.training.recipe import FURTHER_LANDMARKS, Recipe
from workbench.training.report import curves_figure
from workbench.training.scenes import FaceStudio, random_expression, random_lens, random_pose_deg
from workbench.training.shading import Shader, Sky
from workbench.training.skin import skin_painter
from workbench.training.torch_network import TorchLandmarkNetwork
from workbench.training.trainings import TRAININGS
from workbench.training.wardrobe import open_wardrobe

PLAN = TrainingPlan(phases=(Phase(32, 4, 3, 1e-3), Phase(64, 2, 2, 1e-3)), widths=(4, 4, 6, 6), blocks=1)


OTHER = TorchLandmarkNetwork((6, 6, 8, 8), 1, 70).state_dict()
WRONG_CHECKPOINTS = {
    "without its network": lambda state: {name: value for name, value in state.items() if name != "network"},
    "with another network": lambda state: state | {"network": OTHER},
    "with another average": lambda state: state | {"average": OTHER},
    "with a part of the average": lambda state: state | {"average": dict(list(state["average"].items())[1:])},
    "a list": lambda state: list(state),
}
"""What may be in a file that PyTorch reads."""


@pytest.fixture(scope="module")
def pool_folder(tmp_path_factory):
    return write_dotted_pool(tmp_path_factory.mktemp("pool"))


@pytest.fixture(scope="module")
def pool(pool_folder) -> Pool:
    return open_pool(pool_folder)


def quiet(_line: str) -> None:
    """No report."""


def train_a_phase(pool_folder: Path, folder: Path, plan: TrainingPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that is interrupted in its second phase."""
    batch = LandmarkTask.batch

    def interrupted(task, pool, phase, rngs):
        if phase.input_side == 64:
            raise KeyboardInterrupt
        return batch(task, pool, phase, rngs)

    with monkeypatch.context() as patched:
        patched.setattr(LandmarkTask, "batch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(LandmarkTask(), pool_folder, folder, plan, 0, every=2, report=quiet)


def write_second_shard(pool_folder: Path) -> None:
    """Add the pictures of the first shard of a pool, upside down."""
    (pictures, numbers), (more_pictures, more_numbers) = (shard_paths(pool_folder, shard) for shard in (0, 1))
    np.save(more_pictures, np.load(pictures)[:, ::-1])
    shutil.copy(numbers, more_numbers)


def weights_of_size(path: Path, **held: str) -> Path:
    """A file that says it holds a landmark network of the plan's size, but for what else it is said to hold."""
    write_weights(path, {}, {"architecture": NAME, "widths": "[4, 4, 6, 6]", "blocks": "1", **held})
    return path


def answers(errors_percent, mass, truth=None) -> Answers:
    """Answers whose errors to the right are these, in percent of the outer-eye distance."""
    truth = np.tile(MEAN_SHAPE * 100, (len(errors_percent), 1, 1)) if truth is None else truth
    unit = np.linalg.norm(truth[:, 45] - truth[:, 36], axis=-1)[:, None]
    points = truth.copy()
    points[..., 0] += np.asarray(errors_percent) / 100 * unit
    return Answers(points, truth, np.zeros((len(truth), 3)), np.asarray(mass, float))


@pytest.fixture(scope="module")
def gazing():
    """The head with the eyes' units."""
    return load_default_head(gaze=True)


@pytest.fixture(scope="module")
def studio(gazing):
    if not gl_available():
        pytest.skip("VTK finds no OpenGL here")
    made = FaceStudio(gazing, skin_painter(gazing))
    yield made
    made.close()


@pytest.fixture(scope="module")
def shader(head):
    return Shader(head)


class TestRenders:
    def test_the_same_seed_gives_the_same_picture_and_another_seed_another_person(self, studio):
        shots = []
        for seed in (1, 1, 2):
            rng = np.random.default_rng(seed)
            shots.append(studio.shoot(studio.cast(rng), rng))
        assert np.array_equal(shots[0].rgba, shots[1].rgba)
        assert np.array_equal(shots[0].points, shots[1].points)
        assert not np.array_equal(shots[0].rgba, shots[2].rgba)

    def test_landmarks_lie_on_the_head_and_fill_the_middle_of_the_picture(self, studio):
        for seed in range(6):
            rng = np.random.default_rng(seed)
            who = studio.cast(rng)
            shot = studio.shoot(who, rng)
            face = frame_from_points(shot.points[:68])
            assert face.side == pytest.approx(320 / 2.2, rel=0.03)
            assert face.origin == pytest.approx(np.full(2, 159.5), abs=3)
            covered = cv2.dilate(shot.rgba[..., 3], np.ones((5, 5), np.uint8))
            inner = np.clip(np.rint(shot.points[17:]).astype(int), 0, 319)
            assert (covered[inner[:, 1], inner[:, 0]] > 0).mean() > 0.95

    def test_pupils_lie_between_the_corners_of_open_eyes_and_move_with_the_gaze(self, gazing):
        ring = pupil_vertices(gazing)
        corners = gazing.landmarks.of(gazing.neutral)[[36, 39, 42, 45]]
        pupils = gazing.neutral[ring].mean(axis=1)
        assert corners[0, 0] < pupils[0, 0] < corners[1, 0] < 0 < corners[2, 0] < pupils[1, 0] < corners[3, 0]
        weights = np.array([float(name == "eyeLookOutLeft") for name in gazing.expression_names])
        moved = gazing.vertices(weights)[ring].mean(axis=1) - pupils
        assert moved[1, 0] > 3
        assert np.abs(moved[0]).max() < 0.1

    def test_most_people_wear_the_art_of_the_head_and_some_are_painted(self, studio):
        people = [studio.cast(np.random.default_rng(seed)) for seed in range(16)]
        dressed = [who for who in people if who.worn is not None]
        assert 8 <= len(dressed) < 16
        kinds = [{part.part.kind for part in who.worn} for who in dressed]
        assert all({"eyes", "corneas", "teeth", "tongue"} <= worn for worn in kinds)
        assert 0 < sum("hair" in worn for worn in kinds) < len(kinds)
        tones = [who.albedo[300, 256].astype(int) for who in dressed]
        assert np.ptp(np.mean(tones, axis=1)) > 40

    def test_brows_that_are_worn_have_their_landmarks_in_the_hair_from_one_end_to_the_other(self, gazing):
        """On the cards' own opaque texels, in the order of the landmarks, near the head's own ones."""
        wardrobe = open_wardrobe(gazing, 64)
        own = gazing.landmarks.of(gazing.neutral)[17:27]
        for style in ("eyebrow001", "eyebrow007", "eyebrow012"):
            part = wardrobe.store.read("brows", style, len(gazing.neutral))
            line = wardrobe.brow_line(style)
            points = line.of(part.on(gazing.neutral))
            assert (np.diff(points[:, 0]) > 0).all()
            assert points[4, 0] < 0 < points[5, 0]
            assert np.abs(points - own).max() < 12

    def test_brows_lie_lower_on_the_skin_at_their_outer_ends_most_and_their_landmarks_with_them(self, gazing):
        place, head = BrowPlace(lower_mm=4.0, outer_mm=5.0), gazing.neutral
        wardrobe, own = open_wardrobe(gazing, 64), gazing.landmarks.of(gazing.neutral)[17:27]
        lowered = brow_landmarks(gazing, place).of(head) - own
        assert np.abs(lowered[:, 0]).max() < 0.01
        assert lowered[:5, 1] == pytest.approx(lowered[:4:-1, 1], abs=0.2)
        assert lowered[0, 1] == pytest.approx(9.0, abs=0.1)
        assert lowered[4, 1] == pytest.approx(4.0, abs=0.1)
        assert (np.diff(lowered[:5, 1]) < 0).all()
        part = wardrobe.store.read("brows", "eyebrow007", len(head))
        moved = brows_at(part, gazing, place)
        skin, line = np.einsum("nk,nkc->nc", moved.weights, head[moved.anchors]), wardrobe.brow_line("eyebrow007")
        assert np.linalg.norm(moved.on(head) - skin, axis=1) == pytest.approx(np.full(len(skin), 0.8))
        before, after = line.of(part.on(head)), line.of(moved.on(head))
        assert after[:, :2] - before[:, :2] == pytest.approx(
            np.column_stack([np.zeros(10), place.of(before[:, 0], gazing.landmarks.of(head)[17:27])]), abs=0.5
        )

    def test_brows_may_be_thicker_about_their_line(self, gazing):
        head, line = gazing.neutral, gazing.landmarks.of(gazing.neutral)[17:27]
        part = open_wardrobe(gazing, 64).store.read("brows", "eyebrow009", len(head))
        usual, thick = (brows_at(part, gazing, BrowPlace(thickness=times)).on(head) for times in (1.0, 1.5))
        beyond = [points[:, 1] - np.interp(points[:, 0], line[:, 0], line[:, 1]) for points in (usual, thick)]
        # Where the skin is bent, what hovers before it leans.
        assert beyond[1] == pytest.approx(1.5 * beyond[0], abs=0.5)
        assert np.ptp(beyond[0]) > 8

    def test_denser_brows_let_less_skin_through_and_keep_their_colours_and_their_outline(self):
        hairs = np.random.default_rng(0).integers(0, 255, (8, 8, 4), np.uint8)
        hairs[0, :4, 3] = 0, 51, 128, 255
        twice = denser(hairs, 2.0)
        assert twice[0, :4, 3].tolist() == [0, 92, 192, 255]
        assert np.array_equal(twice[..., :3], hairs[..., :3])
        assert np.array_equal(denser(hairs, 1.0), hairs)

    def test_brows_of_people_lie_anywhere_between_a_little_above_the_landmarks_and_the_lids(self, gazing, studio):
        line = gazing.landmarks.of(gazing.neutral)[17:27]
        places = [random_brow_place(np.random.default_rng(seed)) for seed in range(200)]
        lower = np.array([place.of(line[:, 0], line) for place in places])
        assert lower.min() >= -3
        assert lower.max() <= 13
        assert lower.mean(axis=0)[[0, 4]] == pytest.approx([7.0, 3.0], abs=0.6)
        assert lower[:, 2].std() > 2.5
        who = [studio.cast(np.random.default_rng(seed)) for seed in range(4)]
        heights = [person.brows.of(gazing.neutral)[2, 1] for person in who]
        assert np.ptp(heights) > 1

    def test_a_lens_moves_the_corner_of_a_picture_by_a_tenth_at_most(self):
        width = 0.8
        lenses = np.array([random_lens(np.random.default_rng(seed), width) for seed in range(100)])
        moved = np.abs(lenses[:, 0]) * 0.5 * width**2
        assert 0.05 < moved.max() <= 0.1 + 1e-9
        assert np.mean(moved == 0) > 0.5

    def test_poses_and_expressions_stay_in_range_and_close_the_eyes_now_and_then(self, head):
        rng = np.random.default_rng(0)
        poses = np.array([random_pose_deg(rng, 90.0) for _ in range(500)])
        assert np.abs(poses).max(axis=0) == pytest.approx([90, 35, 20], abs=6)
        weights = np.array([random_expression(head.expression_names, rng) for _ in range(500)])
        assert weights.min() >= 0
        assert weights.max() <= 1
        assert np.mean(weights[:, head.expression_names.index("eyeBlinkLeft")] > 0.8) > 0.05
        assert np.mean(weights[:, head.expression_names.index("jawOpen")] > 0.5) > 0.05


class TestShading:
    def test_hollows_see_less_of_the_sky_than_the_forehead(self, head, shader):
        inner_corner, forehead = (np.argmin(np.linalg.norm(head.neutral - at, axis=1)) for at in (
            head.landmarks.of(head.neutral)[39], head.landmarks.of(head.neutral)[27] + [0, -45, 0]))  # fmt: skip
        assert shader.openness[inner_corner] < 0.85 * shader.openness[forehead]

    def test_a_light_from_the_side_leaves_the_other_cheek_dark_and_from_the_front_reaches_both(self, head, shader):
        landmarks, skin = head.landmarks.of(head.neutral), np.unique(shader.outer)
        cheeks = [
            skin[np.argmin(np.linalg.norm(head.neutral[skin] - (landmarks[wing] + landmarks[jaw]) / 2, axis=1))]
            for wing, jaw in ((31, 3), (35, 13))
        ]
        aside = shader.reached(head.neutral, np.array([-0.98, 0.0, -0.2]))[cheeks]
        ahead = shader.reached(head.neutral, np.array([0.0, 0.0, -1.0]))[cheeks]
        assert aside[0] > 0.8 > 0.5 > aside[1]
        assert ahead.min() > 0.8

    def test_teeth_are_lit_as_the_lips_are(self, head, shader):
        """A closed mouth leaves them no light, and renders of smiles would all be black inside."""
        front = Lighting((Light((0.0, 0.0, -1.0), 1.0),), 0.3)
        light = shader.light(head.neutral, front, Sky(np.ones((3, 2, 3)))) / 255.0
        lips = np.intersect1d(head.regions["lips"], np.unique(shader.outer))
        for part in ("teethU", "teethL", "tongue"):
            assert light[head.regions[part]].min() > light[lips].mean() > 0.6

    def test_what_is_before_the_face_darkens_it(self, head, shader):
        lighting = Lighting((Light((0.0, 0.0, -1.0), 1.0),), 0.1)
        sky = Sky(np.ones((3, 2, 3)))
        grid = np.stack(np.meshgrid(np.arange(-90, 90, 2.0), np.arange(-120, 120, 2.0)), axis=-1).reshape(-1, 2)
        board = np.column_stack([grid, np.full(len(grid), head.neutral[:, 2].min() - 80)])
        tip = head.landmarks.vertices[30, 0]
        open_, hidden = (shader.light(head.neutral, lighting, sky, cover)[tip, 0] for cover in ((), (board,)))
        assert hidden < 0.3 * open_

    def test_a_sky_lights_what_looks_at_it(self):
        sides = np.zeros((3, 2, 3))
        sides[1, 0] = 1.0
        lit = Sky(sides).on(np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
        assert lit[:, 0] == pytest.approx([1, 0, 0])


class TestAugmentation:
    def test_renders_fade_at_their_border_and_nowhere_else(self, pool):
        rgba, _ = cut_out(pool, 0)
        before, _ = pool.picture(0)
        assert rgba[0].max() <= before[0].max() / 20
        assert np.array_equal(rgba[40:-40, 40:-40], before[40:-40, 40:-40])

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
        landmarks = points[:68].astype(float)
        view = crop_frame(frame_from_points(landmarks))
        expected = view.to_face(landmarks)
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
        points = torch.rand(2, 70, 2) * 10 + 2
        target = target_distribution(points, 16).view(2, 70, 16, 16)
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
        maps = torch.randn(1, 70, 8, 8)
        even, _ = loss_of(torch.zeros_like(maps), torch.zeros(1, 70, 2) + 4, torch.zeros(1))
        sure, _ = loss_of(20 * maps, torch.zeros(1, 70, 2) + 4, torch.zeros(1))
        assert even < sure

    def test_lids_that_are_off_apart_cost_more_than_lids_that_are_off_together(self):
        points = torch.full((1, 70, 2), 8.0)
        apart, together = points.clone(), points.clone()
        apart[:, 37, 1] += 0.6
        apart[:, 41, 1] -= 0.6
        together[:, [37, 41], 1] += 0.6
        costs = [
            loss_of(torch.log(target_distribution(read, 16).view(1, 70, 16, 16) + 1e-6), points, torch.ones(1))[0]
            for read in (apart, together)
        ]
        assert costs[0] > costs[1] + 0.005


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
        for seed in range(250):
            picture, boxes = crowd(pool, np.random.default_rng(seed), 64)
            there = boxes[boxes[:, 2] > 0]
            assert picture.shape == (64, 64, 3)
            assert ((there[:, :2] > 0) & (there[:, :2] < 63)).all()
            counts.append(len(there))
        assert min(counts) == 0
        assert max(counts) >= 2

    def test_a_face_that_nobody_could_see_is_none(self):
        picture = np.full((64, 64, 3), 12, np.uint8)
        box = np.array([30.0, 30.0, 20.0], np.float32)
        assert not can_be_seen(picture, box)
        picture[26:34, 26:34] = 90
        assert can_be_seen(picture, box)
        assert not can_be_seen(picture, np.array([55.0, 10.0, 12.0], np.float32))


class TestLoop:
    def test_an_interrupted_training_ends_with_the_same_weights_and_tells_each_step_once(
        self, pool_folder, tmp_path, monkeypatch
    ):
        whole = train(LandmarkTask(), pool_folder, tmp_path / "whole", PLAN, 0, every=2, report=quiet)
        train_a_phase(pool_folder, tmp_path / "parts", PLAN, monkeypatch)
        # What it had told of steps after its last checkpoint, which are repeated, and half a row.
        told = (tmp_path / "whole" / "curves.csv").read_text()
        (tmp_path / "parts" / "curves.csv").write_text(told + "\n3")
        lines = []
        resumed = train(LandmarkTask(), pool_folder, tmp_path / "parts", PLAN, 0, every=2, report=lines.append)
        assert [line for line in lines if line.startswith("step 6 of 6")] == lines
        first, second = read_weights(whole).arrays, read_weights(resumed).arrays
        assert max(np.abs(first[name] - second[name]).max() for name in first) < 1e-5
        rows = (tmp_path / "parts" / "curves.csv").read_text().splitlines()
        assert [row.split(",")[0] for row in rows] == ["step", "6"]

    def test_an_interrupted_training_ends_with_the_same_curves(self, pool_folder, tmp_path, monkeypatch):
        train_a_phase(pool_folder, tmp_path / "parts", PLAN, monkeypatch)
        for name in ("whole", "parts"):
            train(LandmarkTask(), pool_folder, tmp_path / name, PLAN, 0, every=2, report=quiet)
        whole, parts = ((tmp_path / name / "curves.csv").read_text() for name in ("whole", "parts"))
        assert parts == whole

    def test_a_checkpoint_of_before_without_the_numbers_of_the_curves_goes_on(self, pool_folder, tmp_path, monkeypatch):
        train_a_phase(pool_folder, tmp_path, PLAN, monkeypatch)
        checkpoint = tmp_path / "checkpoint.pt"
        state = torch.load(checkpoint, weights_only=True)
        del state["running"]
        torch.save(state, checkpoint)
        lines = []
        train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=lines.append)
        assert [line for line in lines if line.startswith("step 6 of 6")] == lines

    @pytest.mark.parametrize(
        ("damaged", "kept"),
        [
            (lambda told: told + b"\xff\xfe\x00,\n", ["step", "2", "4", "6"]),
            (lambda told: told.replace(b"\n2,", b"\n2\xff,"), ["step", "4", "6"]),
            (lambda told: told.replace(b"e-0", b"\xffe-0", 1), ["step", "4", "6"]),
            (lambda told: b"\xff" + told, ["step", "6"]),
            (lambda told: b"", ["step", "6"]),
        ],
        ids=["rows of junk", "a step", "a number", "the names", "all"],
    )
    def test_damaged_curves_keep_what_can_be_read_and_the_training_goes_on(
        self, pool_folder, tmp_path, monkeypatch, damaged, kept
    ):
        train_a_phase(pool_folder, tmp_path, PLAN, monkeypatch)
        told = b"step,rate,loss\r\n2,1.000e-03,3.1000\r\n4,1.000e-03,2.1000\r\n"
        (tmp_path / "curves.csv").write_bytes(damaged(told))
        train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)
        rows = (tmp_path / "curves.csv").read_text().splitlines()
        assert [row.split(",")[0] for row in rows] == kept

    def test_curves_that_cannot_be_written_are_told_in_a_sentence(self, pool_folder, tmp_path):
        (tmp_path / "curves.csv").mkdir()
        with pytest.raises(OutputError, match=r"curves\.csv cannot be written .*; a folder is in the way"):
            train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)

    @pytest.mark.parametrize(("rows", "marker"), [(1, "o"), (3, "o"), (60, "")])
    def test_curves_of_few_rows_are_drawn_as_points(self, tmp_path, rows, marker):
        lines = ["step,rate,loss,inner_percent", *(f"{50 * (k + 1)},1e-3,{3 / (k + 1)},9" for k in range(rows))]
        (tmp_path / "curves.csv").write_text("\n".join(lines) + "\n")
        figure = curves_figure(tmp_path / "curves.csv")
        assert [line.get_marker() or "" for axis in figure.axes for line in axis.lines] == [marker, marker]

    def test_a_finished_training_whose_curves_are_gone_is_reported_without_them(self, tmp_path):
        assert [len(axis.lines[0].get_xdata()) for axis in curves_figure(tmp_path / "curves.csv").axes] == [0, 0]

    def test_pictures_that_another_training_added_to_the_pool_do_not_count(self, tmp_path, monkeypatch):
        monkeypatch.setattr(loop, "_POOLS", {})
        (pool_folder := tmp_path / "pool").mkdir()
        plan = replace(PLAN, pictures=SHARD)
        write_dotted_pool(pool_folder)
        train_a_phase(pool_folder, tmp_path / "parts", plan, monkeypatch)
        whole = train(LandmarkTask(), pool_folder, tmp_path / "whole", plan, 0, every=2, report=quiet)
        loop._POOLS.clear()
        write_second_shard(pool_folder)
        resumed = train(LandmarkTask(), pool_folder, tmp_path / "parts", plan, 0, every=2, report=quiet)
        first, second = read_weights(whole).arrays, read_weights(resumed).arrays
        assert max(np.abs(first[name] - second[name]).max() for name in first) < 1e-5

    def test_a_training_with_another_number_of_pictures_is_refused(self, tmp_path):
        (tmp_path / PLAN_FILE).write_text(json.dumps(asdict(replace(PLAN, pictures=SHARD))))
        with pytest.raises(InputError, match="a training with other options"):
            checked_plan(LandmarkTask(), tmp_path, replace(PLAN, pictures=2 * SHARD))

    def test_a_plan_of_before_that_does_not_tell_its_pictures_goes_on(self, tmp_path):
        before = {name: value for name, value in asdict(PLAN).items() if name != "pictures"}
        (tmp_path / PLAN_FILE).write_text(json.dumps(before))
        plan = replace(PLAN, pictures=SHARD)
        assert checked_plan(LandmarkTask(), tmp_path, plan) == plan

    @pytest.mark.parametrize("content", ['{"pha', '{"phases": []}', '{"phases": [], "widths": [1], "lens": 1}', ""])
    def test_a_damaged_plan_is_reported_with_what_to_do(self, tmp_path, content):
        (tmp_path / PLAN_FILE).write_text(content)
        with pytest.raises(InputError, match=f"{PLAN_FILE} .*the plan of a training.*--overwrite"):
            checked_plan(LandmarkTask(), tmp_path, PLAN)

    def test_a_folder_of_another_plan_is_refused(self, pool_folder, tmp_path):
        train(LandmarkTask(), pool_folder, tmp_path, PLAN, workers=0, report=quiet)
        with pytest.raises(InputError, match=r"a training with other options \(--quick, --start, --device\); use"):
            train(LandmarkTask(), pool_folder, tmp_path, replace(PLAN, seed=2), workers=0, report=quiet)

    @pytest.mark.parametrize(
        ("task", "held", "said"),
        [
            (
                LandmarkTask(),
                {"architecture": "face-energy-1"},
                "holds face-energy-1, expected face-energy-landmarks-1",
            ),
            (EyeTask(), {}, "holds face-energy-landmarks-1, expected face-energy-eye-1: start from another"),
            (
                DenseTask(),
                {"architecture": "fan"},
                "holds fan, expected face-energy-dense-1 or face-energy-landmarks-1",
            ),
            (
                LandmarkTask(),
                {"widths": "[8, 8, 8, 8]"},
                r"widths \[8, 8, 8, 8\] and blocks 1, expected \[4, 4, 6, 6\]",
            ),
            (DenseTask(), {"blocks": "2"}, r"widths \[4, 4, 6, 6\] and blocks 2, expected \[4, 4, 6, 6\] and 1: start"),
        ],
    )
    def test_weights_of_another_network_or_size_are_refused_before_anything_is_written(
        self, tmp_path, task, held, said
    ):
        start = weights_of_size(tmp_path / "start.safetensors", **held)
        with pytest.raises(InputError, match=said):
            train(task, tmp_path / "pool", tmp_path / "nets", PLAN, 0, report=quiet, start=start)
        assert not (tmp_path / "nets").exists()

    @pytest.mark.parametrize(
        ("device", "said"),
        [("cuda", "no CUDA device here; leave out --device"), ("cuda:0", "on cpu or cuda, got cuda:0")],
    )
    def test_a_device_that_is_not_there_is_refused_before_anything_is_written(
        self, tmp_path, monkeypatch, device, said
    ):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
        with pytest.raises(InputError, match=said):
            train(LandmarkTask(), tmp_path / "pool", tmp_path / "nets", PLAN, 0, device, report=quiet)
        assert not (tmp_path / "nets").exists()

    def test_a_training_goes_on_from_weights_and_says_from_which(self, pool_folder, tmp_path):
        """One step at a rate of next to nothing leaves what they answer as it was."""
        start = train(LandmarkTask(), pool_folder, tmp_path / "start", PLAN, 0, report=quiet)
        still = replace(PLAN, phases=(Phase(64, 1, 4, 1e-9),))
        further = train(LandmarkTask(), pool_folder, tmp_path / "on", still, 0, report=quiet, start=start)
        picture = jnp.asarray(np.random.default_rng(0).random((3, 64, 64)), jnp.float32)
        before, after = (np.asarray(read_landmark_network(path)(picture)) for path in (start, further))
        assert np.abs(before - after).max() < 0.02 * np.abs(before).max()
        assert read_weights(further).metadata["start"] == hashlib.sha256(start.read_bytes()).hexdigest()
        with pytest.raises(InputError, match="expected face-energy-finder-1"):
            train(FinderTask(), pool_folder, tmp_path / "other", still, 0, report=quiet, start=start)

    def test_a_plan_keeps_a_share_of_what_it_began_with(self, pool_folder, tmp_path):
        start = train(LandmarkTask(), pool_folder, tmp_path / "start", PLAN, 0, report=quiet)
        began, learned, mean = (read_weights(start).arrays, *(
            read_weights(
                train(LandmarkTask(), pool_folder, tmp_path / str(share), replace(PLAN, learned=share), 0,
                      report=quiet, start=start)
            ).arrays
            for share in (1.0, 0.25)
        ))  # fmt: skip
        assert mean.keys() == learned.keys()
        for name, weights in mean.items():
            np.testing.assert_allclose(weights, 0.75 * began[name] + 0.25 * learned[name], atol=1e-7)
        assert np.abs(learned["head.weight"] - began["head.weight"]).max() > 1e-5

    def test_what_the_start_lacks_is_kept_as_learned(self, pool_folder, tmp_path):
        with_pupils = read_weights(train(LandmarkTask(), pool_folder, tmp_path / "start", PLAN, 0, report=quiet))
        old = {name: array for name, array in with_pupils.arrays.items() if not name.startswith("pupils")}
        write_weights(tmp_path / "old.safetensors", old, with_pupils.metadata)
        learned, mean = (
            read_weights(
                train(LandmarkTask(), pool_folder, tmp_path / str(share), replace(PLAN, learned=share), 0,
                      report=quiet, start=tmp_path / "old.safetensors")
            ).arrays
            for share in (1.0, 0.25)
        )  # fmt: skip
        np.testing.assert_array_equal(mean["pupils.weight"], learned["pupils.weight"])

    @pytest.mark.parametrize(("pictures", "opened"), [(1, 1), (SHARD, 1), (SHARD + 1, 2), (9 * SHARD, 2), (None, 2)])
    def test_as_much_of_a_pool_is_opened_as_is_asked_for(self, tmp_path, pictures, opened):
        write_dotted_pool(tmp_path)
        write_second_shard(tmp_path)
        assert len(open_pool(tmp_path, pictures)) == opened * SHARD

    def test_a_pools_processes_draw_in_the_window_that_needs_no_display(self, tmp_path, monkeypatch):
        monkeypatch.delenv(WINDOW_VARIABLE, raising=False)
        make_shards(write_window, tmp_path, 1, 1, 1)
        assert (tmp_path / "window_0").read_text() == (_working_window() or "VTK's own choice")

    @pytest.mark.parametrize("part", [0, 1])
    @pytest.mark.parametrize("cut", [0, 0.5])
    def test_a_damaged_pool_is_reported_with_what_to_do(self, tmp_path, part, cut):
        write_dotted_pool(tmp_path)
        path = shard_paths(tmp_path, 0)[part]
        path.write_bytes(path.read_bytes()[: int(cut * path.stat().st_size)])
        with pytest.raises(InputError, match=f"{path.name} cannot be read as a part of a training's pool .*; delete"):
            open_pool(tmp_path)

    @pytest.mark.parametrize(
        ("name", "value", "said"),
        [
            ("glasses", None, "it lacks glasses"),
            ("angles", np.zeros((3, 3)), r"angles should have 240 rows, got the shape \(3, 3\)"),
            ("points", np.float32(0.0), r"points should have 240 rows, got the shape \(\)"),
        ],
    )
    def test_a_part_of_a_pool_that_lacks_something_is_reported_with_what_to_do(self, tmp_path, name, value, said):
        write_dotted_pool(tmp_path)
        path = shard_paths(tmp_path, 0)[1]
        numbers = dict(np.load(path)) | {name: value}
        np.savez(path, **{name: array for name, array in numbers.items() if array is not None})
        with pytest.raises(InputError, match=f"{path.name} cannot be read as a part of .* pool \\({said}\\); delete"):
            open_pool(tmp_path)

    def test_pictures_that_are_too_few_are_reported_with_what_to_do(self, tmp_path):
        write_dotted_pool(tmp_path)
        path = shard_paths(tmp_path, 0)[0]
        np.save(path, np.load(path)[:5])
        with pytest.raises(InputError, match=r"pictures_0000 should have 240 rows, got the shape \(5, .*; delete it"):
            open_pool(tmp_path)

    @pytest.mark.parametrize("cut", [0, 0.5])
    def test_a_damaged_checkpoint_is_reported_with_what_to_do(self, pool_folder, tmp_path, monkeypatch, cut):
        train_a_phase(pool_folder, tmp_path, PLAN, monkeypatch)
        checkpoint = tmp_path / "checkpoint.pt"
        checkpoint.write_bytes(checkpoint.read_bytes()[: int(cut * checkpoint.stat().st_size)])
        with pytest.raises(InputError, match=r"checkpoint\.pt cannot be read as a training's checkpoint .*--overwrite"):
            train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)

    @pytest.mark.parametrize("wrong", WRONG_CHECKPOINTS)
    def test_a_checkpoint_of_something_else_is_reported_with_what_to_do(
        self, pool_folder, tmp_path, monkeypatch, wrong
    ):
        train_a_phase(pool_folder, tmp_path, PLAN, monkeypatch)
        checkpoint = tmp_path / "checkpoint.pt"
        torch.save(WRONG_CHECKPOINTS[wrong](torch.load(checkpoint, weights_only=True)), checkpoint)
        before = checkpoint.read_bytes()
        refused = r"checkpoint\.pt cannot be read as a training's checkpoint .*; add --overwrite"
        with pytest.raises(InputError, match=refused):
            train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)
        assert checkpoint.read_bytes() == before
        if "network" not in wrong:
            with pytest.raises(InputError, match=refused):
                export_weights(LandmarkTask(), tmp_path)

    def test_a_full_disk_leaves_the_last_checkpoint_and_weights_and_says_what_to_do(
        self, pool_folder, tmp_path, monkeypatch
    ):
        train_a_phase(pool_folder, tmp_path, PLAN, monkeypatch)
        checkpoint = (tmp_path / "checkpoint.pt").read_bytes()
        refused = pytest.raises(OutputError, match=r"checkpoint\.pt cannot be written \(File too large\); ")
        with refused, small_disk(10_000):
            train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)
        assert (tmp_path / "checkpoint.pt").read_bytes() == checkpoint
        weights = train(LandmarkTask(), pool_folder, tmp_path, PLAN, 0, every=2, report=quiet)
        before = weights.read_bytes()
        refused = pytest.raises(OutputError, match=r"weights\.safetensors cannot be written \(File too large\); ")
        with refused, small_disk(1000):
            export_weights(LandmarkTask(), tmp_path)
        assert weights.read_bytes() == before
        assert not list(tmp_path.glob(".*"))

    def test_no_pool_is_a_clear_error(self, tmp_path):
        with pytest.raises(InputError, match="no pool of rendered heads: `workbench train landmarks FOLDER` makes"):
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
        weights = replace(weights, arrays=folded_arrays(network, 1 / 50))  # a head of 68, and no pupils
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

    def test_the_calibration_of_a_network_that_is_often_sure_ascends_within_its_range(self):
        mass = np.random.default_rng(0).uniform(0.2, 1, (60, 68))
        mass[42:] = 0.9999
        knots, _ = calibration_of(answers(np.zeros_like(mass), mass))
        assert (np.diff(knots) > 0).all()
        assert 0 <= knots[0] < knots[-1] <= 1

    def test_one_picture_is_enough_for_a_calibration(self):
        mass = np.random.default_rng(0).uniform(0, 1, (1, 68))
        knots, confidence = calibration_of(answers(np.where(mass > 0.5, 1.0, 20.0), mass))
        assert (np.diff(knots) > 0).all()
        assert (np.diff(confidence) >= 0).all()

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

    def test_lids_that_are_read_too_open_are_told_with_where_they_are(self):
        heights = np.linspace(0.0, 0.6, 25)
        faces = np.repeat(MEAN_SHAPE[None], len(heights), axis=0)
        lower, upper = [41, 40, 47, 46], [37, 38, 43, 44]
        faces[:, upper, 1] = MEAN_SHAPE[lower, 1] - heights[:, None] * (MEAN_SHAPE[lower, 1] - MEAN_SHAPE[upper, 1])
        true = np.array([lid_openings(face).mean() for face in faces])
        read = faces.copy()
        read[:, upper, 1] -= 0.05 * np.linalg.norm(MEAN_SHAPE[39] - MEAN_SHAPE[36])
        table = lids_of(Answers(read, faces, np.zeros((len(faces), 3)), np.ones((len(faces), 68))))
        assert table[:, 2].sum() == 2 * (true + 0.05 < 0.2425).sum()
        known = table[:, 2] > 0
        assert table[known, 1] == pytest.approx(table[known, 0] - 0.05, abs=0.02)


class TestTrainings:
    def test_every_network_of_the_command_line_has_a_recipe(self):
        assert set(TRAININGS) == set(Network) == set(RESULTS)

    def test_weights_to_go_on_from_are_followed_by_the_shorter_plan(self):
        recipe = TRAININGS["landmarks"].recipe(quick=False, start=Path("there.safetensors"))
        assert recipe == replace(FURTHER_LANDMARKS, start=Path("there.safetensors"))
        assert TRAININGS["landmarks"].recipe(quick=False, start=None) == Recipe()

    def test_on_a_gpu_pictures_of_faces_are_made_in_batches_and_others_as_always(self):
        start = Path("there.safetensors")
        for network in ("landmarks", "dense"):
            assert TRAININGS[network].recipe(quick=False, start=None, device="cuda").plan.batched
            assert TRAININGS[network].recipe(quick=False, start=start, device="cuda").start == start
            assert not TRAININGS[network].recipe(quick=True, start=None, device="cuda").plan.batched
        assert TRAININGS["finder"].recipe(False, None, "cuda") == TRAININGS["finder"].recipe(False, None)

    @pytest.mark.parametrize("network", ["landmarks", "finder", "dense", "eyes"])
    def test_weights_that_do_not_fit_are_refused_before_anything_is_rendered(self, tmp_path, monkeypatch, network):
        monkeypatch.setattr("workbench.training.recipe.make_pool", None)
        training, start = TRAININGS[network], weights_of_size(tmp_path / "start.safetensors")
        with pytest.raises(InputError, match=r"start from another"):
            training.make(tmp_path, training.recipe(False, start), 1, "cpu", quiet)

    def test_a_flow_training_of_another_plan_is_refused_before_anything_is_rendered(self, tmp_path, monkeypatch):
        monkeypatch.setattr("workbench.training.flow_recipe.make_pair_pool", None)
        (tmp_path / "flow").mkdir()
        (tmp_path / "flow" / PLAN_FILE).write_text(json.dumps(asdict(PLAN)))
        with pytest.raises(InputError, match="other options"):
            TRAININGS["flow"].make(tmp_path, TRAININGS["flow"].quick, 1, "cpu", quiet)

    @pytest.mark.parametrize(("network", "module"), [("finder", "recipe"), ("flow", "flow_recipe")])
    def test_the_plan_says_how_many_pictures_are_learned_from(self, tmp_path, monkeypatch, network, module):
        plans = []

        def stopped(task, pool, folder, plan, *_args, **_options):
            plans.append(plan)
            raise KeyboardInterrupt

        monkeypatch.setattr("workbench.training.pool.make_shards", lambda *_args: None)
        monkeypatch.setattr("workbench.training.flow_pool.make_shards", lambda *_args: None)
        monkeypatch.setattr(f"workbench.training.{module}.train", stopped)
        with pytest.raises(KeyboardInterrupt):
            TRAININGS[network].make(tmp_path, TRAININGS[network].quick, 1, "cpu", quiet)
        assert [plan.pictures for plan in plans] == [{"finder": 240, "flow": 120}[network]]

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["--device", "cuda"], "PyTorch finds no CUDA device here"),
            (["--device", "gpu"], "'gpu' is not one of"),
            (["--start", "typo.safetensors"], "there is no weights file typo.safetensors"),
            (["--start", "small.safetensors"], "expected [32, 64, 128, 192] and 2: start from another"),
        ],
    )
    def test_mistakes_in_the_options_are_noticed_before_anything_is_deleted(
        self, tmp_path, monkeypatch, run, options, said
    ):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
        weights_of_size(tmp_path / "small.safetensors")
        begun = tmp_path / "nets" / "landmarks"
        begun.mkdir(parents=True)
        (begun / PLAN_FILE).write_text("the plan")
        code, _, err = run("train", "landmarks", "nets", "--overwrite", *options)
        assert code == 2
        assert said in err
        assert (begun / PLAN_FILE).exists()

    @pytest.mark.parametrize(("network", "quick"), [("flow", False), ("landmarks", True)])
    def test_what_cannot_go_on_says_so(self, network, quick):
        with pytest.raises(InputError, match="leave out --start"):
            TRAININGS[network].recipe(quick=quick, start=Path("there.safetensors"))
