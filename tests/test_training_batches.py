"""Training pictures in whole batches: they are what `augment` makes one by one, and say truly where everything is."""

from functools import partial

import cv2
import numpy as np
import pytest
import torch

from tests.dotted_pool import write_dotted_pool
from workbench.errors import InputError
from workbench.landmarks.scheme import MIRROR
from workbench.networks.weights import read_weights
from workbench.training import augment, batch_studio, loop, variation
from workbench.training.augment import augmented
from workbench.training.batch_camera import Dice, blurred, jpeg, photographed
from workbench.training.batch_studio import BatchStudio, Props
from workbench.training.finder_task import FinderTask
from workbench.training.landmark_task import LandmarkTask
from workbench.training.loop import Phase, TrainingPlan, train
from workbench.training.pool import open_pool

FEW = Props(backgrounds=6, occluders=6, shoulders=3)


@pytest.fixture(scope="module")
def pool_folder(tmp_path_factory):
    return write_dotted_pool(tmp_path_factory.mktemp("pool"))


@pytest.fixture(scope="module")
def pool(pool_folder):
    return open_pool(pool_folder)


@pytest.fixture(scope="module")
def studio(pool):
    return BatchStudio(pool, 64, props=FEW)


def pictures_like_photographs(count: int, side: int = 64) -> np.ndarray:
    """Smooth noise with some edges, (count, side, side, 3), 0..255."""
    rng = np.random.default_rng(4)
    made = [augment.random_background(rng, side) for _ in range(count)]
    return np.clip(made, 0, 255).astype(np.uint8)


def quiet(_text: str) -> None:
    pass


def as_tensor(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures).permute(0, 3, 1, 2).float()


class TestCamera:
    @pytest.mark.parametrize("quality", [12, 35, 60, 89])
    def test_jpeg_leaves_what_opencvs_leaves(self, quality):
        pictures = pictures_like_photographs(6)
        ours = jpeg(as_tensor(pictures), torch.full((6,), float(quality)))
        ours = ours.permute(0, 2, 3, 1).numpy()
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        for mine, picture in zip(ours, pictures, strict=True):
            data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), options)[1]
            theirs = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
            apart = np.abs(mine - theirs.astype(float)).mean()
            lost = np.abs(theirs.astype(float) - picture).mean()
            assert apart < 0.25 * lost + 0.5

    def test_a_picture_whose_side_is_no_multiple_of_sixteen_keeps_its_size(self):
        assert jpeg(torch.full((2, 3, 37, 50), 90.0), torch.tensor([20.0, 80.0])).shape == (2, 3, 37, 50)

    def test_each_picture_is_blurred_by_its_own_deviation(self):
        pictures = pictures_like_photographs(3)
        ours = blurred(as_tensor(pictures), torch.tensor([0.6, 1.1, 2.5]), 2.6).permute(0, 2, 3, 1).numpy()
        for mine, picture, deviation in zip(ours, pictures, (0.6, 1.1, 2.5), strict=True):
            picture = picture.astype(np.float32)
            theirs = cv2.GaussianBlur(picture, (17, 17), deviation, borderType=cv2.BORDER_REFLECT_101)
            assert np.abs(mine - theirs).max() < 1.0

    def test_pictures_are_changed_as_much_as_one_by_one(self):
        """The mean change and its spread over 300 photographs of each."""
        pictures = np.repeat(pictures_like_photographs(60), 5, axis=0)
        ours = photographed(as_tensor(pictures), Dice(3, len(pictures), "cpu")).clamp(0, 255)
        ours = np.abs(ours.permute(0, 2, 3, 1).numpy() - pictures).mean((1, 2, 3))
        theirs = [
            augment.photographed(picture.astype(np.float32), np.random.default_rng(k))
            for k, picture in enumerate(pictures)
        ]
        theirs = np.abs(np.clip(theirs, 0, 255) - pictures).mean((1, 2, 3))
        for level in (25, 50, 75):
            assert np.percentile(ours, level) == pytest.approx(np.percentile(theirs, level), rel=0.2)


class TestStudio:
    def test_the_dots_of_the_render_stay_under_the_landmarks(self, pool, monkeypatch):
        """However the picture is framed, turned and mirrored: brightness at the landmarks, not elsewhere."""
        for share in ("OCCLUDED", "SHADOWED", "FACELESS"):
            monkeypatch.setattr(variation, share, 0.0)
        monkeypatch.setattr(batch_studio, "photographed", lambda pictures, _dice: pictures)
        pictures, (points, _) = BatchStudio(pool, 256, props=FEW).shoot(16, seed=2)
        for picture, landmarks in zip(pictures.numpy(), points[:, :68].numpy(), strict=True):
            inside = landmarks[((landmarks > 3) & (landmarks < 248)).all(axis=1)]
            places = np.rint(inside).astype(int)
            bright = cv2.blur(255 * picture.max(axis=0), (3, 3))
            assert bright[places[:, 1], places[:, 0]].mean() > bright[places[:, 1] - 6, places[:, 0] + 5].mean() + 15

    def test_faces_are_framed_as_one_by_one(self, studio, pool):
        """Mean and spread of the landmarks' places, in percent of the side."""
        _, (ours, _) = studio.shoot(600, seed=1)
        theirs = [augmented(pool, k % len(pool), np.random.default_rng(k), 64) for k in range(600)]
        theirs = np.array([made.landmarks for made in theirs if made.is_face])
        ours = ours[:, :68].numpy()
        assert np.abs(ours.mean(0) - theirs.mean(0)).max() < 0.05 * 64
        assert ours.std(0) == pytest.approx(theirs.std(0), rel=0.2)

    def test_half_of_the_faces_are_mirrored(self, studio):
        """A face on its feet that is mirrored has its right on the other side, under the mirrored numbers."""
        _, (points, _) = studio.shoot(200, seed=3)
        right, left = points[:, 36, 0], points[:, MIRROR[36], 0]
        assert float((right < left).float().mean()) > 0.95

    def test_pictures_without_a_face_occur_and_say_so(self, studio):
        _, (_, is_face) = studio.shoot(400, seed=4)
        assert 0.9 < float(is_face.mean()) < 0.99

    def test_the_same_seed_gives_the_same_pictures_and_another_others(self, studio):
        (first, _), (again, _), (other, _) = (studio.shoot(4, seed) for seed in (5, 5, 6))
        assert torch.equal(first, again)
        assert not torch.equal(first, other)
        assert float(first.min()) >= 0
        assert float(first.max()) <= 1


class TestTraining:
    PLAN = TrainingPlan(phases=(Phase(64, 4, 3, 1e-3),), widths=(4, 4, 6, 6), blocks=1, batched=True)

    @pytest.fixture(autouse=True)
    def few_props(self, monkeypatch):
        monkeypatch.setattr(loop, "BatchStudio", partial(BatchStudio, props=FEW))

    def test_an_interrupted_training_ends_with_the_same_weights(self, pool_folder, tmp_path, monkeypatch):
        whole = train(LandmarkTask(), pool_folder, tmp_path / "whole", self.PLAN, 0, every=2, report=quiet)
        loss, steps = LandmarkTask.loss, iter(range(3))

        def interrupted(task, answers, targets):
            if next(steps) == 2:
                raise KeyboardInterrupt
            return loss(task, answers, targets)

        monkeypatch.setattr(LandmarkTask, "loss", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(LandmarkTask(), pool_folder, tmp_path / "parts", self.PLAN, 0, every=2, report=quiet)
        monkeypatch.setattr(LandmarkTask, "loss", loss)
        resumed = train(LandmarkTask(), pool_folder, tmp_path / "parts", self.PLAN, 0, every=2, report=quiet)
        first, second = read_weights(whole).arrays, read_weights(resumed).arrays
        assert max(np.abs(first[name] - second[name]).max() for name in first) < 1e-5

    def test_a_network_that_learns_from_whole_scenes_cannot_follow_such_a_plan(self, pool_folder, tmp_path):
        with pytest.raises(InputError, match="single faces at one size"):
            train(FinderTask(), pool_folder, tmp_path, self.PLAN, 0)

    def test_neither_can_a_plan_of_two_sizes(self, pool_folder, tmp_path):
        plan = TrainingPlan(phases=(Phase(32, 1, 1, 1e-3), Phase(64, 1, 1, 1e-3)), batched=True)
        with pytest.raises(InputError, match="single faces at one size"):
            train(LandmarkTask(), pool_folder, tmp_path, plan, 0)
