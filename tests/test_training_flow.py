"""Training the flow network: pairs show what their flow says, and the task wants that flow."""

import cv2
import numpy as np
import pytest
import torch

from tests.optional_parts import needs_gl
from workbench.errors import InputError
from workbench.flow import DisFlow, end_point_error
from workbench.flow.coloring import flow_picture
from workbench.networks import read_flow_network
from workbench.training.contact_sheet import COLUMNS, pair_samples
from workbench.training.flow_augment import CLEAN, PairHardness, augmented_pair
from workbench.training.flow_measuring import flow_tables, measured_flow
from workbench.training.flow_pool import SHARD, PairPool, open_pair_pool, shard_files
from workbench.training.flow_scenes import FACE, SEEN, VISIBLE, PairStudio, random_expressions
from workbench.training.flow_task import LEVEL_FACTORS, FlowTask
from workbench.training.loop import Phase, TrainingPlan, train
from workbench.training.skin import skin_painter

SIDE = 256
SHIFT = (9, -5)
"""Pixels by which the made-up heads move."""
STILL = PairHardness(motion=0.0, damage=0.0, occlusion=0.0)
PLAN = TrainingPlan(phases=(Phase(64, 2, 2, 1e-3),), widths=(4, 4, 6, 6), blocks=1)


@pytest.fixture(scope="module")
def pool_folder(tmp_path_factory):
    """A pool of textured discs that move by `SHIFT`."""
    folder = tmp_path_factory.mktemp("pairs")
    rng = np.random.default_rng(0)
    noise = cv2.resize(rng.random((40, 40, 3)), (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    disc = np.zeros((SIDE, SIDE), np.uint8)
    cv2.circle(disc, (128, 128), 70, 255, -1)
    first = np.dstack([np.clip(noise * 255, 0, 255).astype(np.uint8) * (disc[..., None] > 0), disc])
    second = cv2.warpAffine(first, np.array([[1, 0, SHIFT[0]], [0, 1, SHIFT[1]]], float), (SIDE, SIDE))
    flow = np.zeros((2, SIDE, SIDE, 2), np.float16)
    marks = np.zeros((2, SIDE, SIDE), np.uint8)
    for k, (picture, way) in enumerate(((first, 1), (second, -1))):
        inside = picture[..., 3] > 127
        flow[k][inside] = way * np.array(SHIFT)
        marks[k][inside] = SEEN | VISIBLE | FACE
    arrays = {
        "pictures": np.broadcast_to(np.stack([first, second]), (SHARD, 2, SIDE, SIDE, 4)),
        "flows": np.broadcast_to(flow, (SHARD, *flow.shape)),
        "marks": np.broadcast_to(marks, (SHARD, *marks.shape)),
        "backgrounds": rng.integers(0, 255, (2, 96, 96, 3)).astype(np.uint8),
    }
    for name, path in shard_files(folder, 0).items():
        np.save(path, arrays[name])
    return folder


@pytest.fixture(scope="module")
def pool(pool_folder) -> PairPool:
    return open_pair_pool(pool_folder)


class TestPairs:
    @pytest.mark.parametrize("hardness", [STILL, CLEAN], ids=["still ground", "moving ground"])
    def test_the_second_picture_read_along_the_flow_is_the_first(self, pool, hardness):
        for seed in range(6):
            pair = augmented_pair(pool, 0, np.random.default_rng(seed), 128, hardness)
            y, x = np.indices((128, 128)).astype(np.float32)
            read = cv2.remap(pair.second, x + pair.flow[..., 0], y + pair.flow[..., 1], cv2.INTER_LINEAR)
            counted = cv2.erode((pair.visible & pair.known & pair.face).astype(np.uint8), np.ones((5, 5))) > 0
            difference = np.abs(read.astype(float) - pair.first).mean(axis=-1)
            assert counted.mean() > 0.05
            assert difference[counted].mean() < 6

    def test_the_ground_stands_still_where_it_should_and_is_hidden_behind_the_head(self, pool):
        pair = augmented_pair(pool, 0, np.random.default_rng(1), 128, STILL)
        moving = np.linalg.norm(pair.flow, axis=-1) > 1
        assert pair.face[moving & pair.known].mean() > 0.97
        hidden = ~pair.visible & ~moving
        assert 0 < hidden.mean() < 0.3

    def test_a_contact_sheet_shows_three_pairs_in_a_row_each_with_its_flow(self, pool_folder, pool):
        samples = list(pair_samples(pool_folder))
        dice = np.random.default_rng(0)
        pair = augmented_pair(pool, int(dice.integers(len(pool))), dice, 256, CLEAN)
        assert len(samples) == 6 * COLUMNS
        for sample, picture in zip(samples, (pair.first, pair.second, flow_picture(pair.flow)), strict=False):
            assert np.array_equal(sample.picture, picture)

    def test_the_same_seed_gives_the_same_pair(self, pool):
        one, two = (augmented_pair(pool, 3, np.random.default_rng(5), 64) for _ in range(2))
        assert np.array_equal(one.first, two.first)
        assert np.array_equal(one.flow, two.flow)

    @pytest.mark.parametrize(("pairs", "opened"), [(1, 1), (SHARD + 1, 2), (None, 2)])
    def test_as_much_of_a_pool_is_opened_as_is_asked_for(self, tmp_path, pairs, opened):
        for shard in (0, 1):
            for path in shard_files(tmp_path, shard).values():
                np.save(path, np.zeros(SHARD))
        assert len(open_pair_pool(tmp_path, pairs)) == opened * SHARD

    @pytest.mark.parametrize("short", ["pictures", "flows", "marks"])
    def test_a_part_of_a_pool_with_too_few_pairs_is_reported_with_what_to_do(self, tmp_path, short):
        for name, path in shard_files(tmp_path, 0).items():
            np.save(path, np.zeros(3 if name == short else SHARD))
        with pytest.raises(InputError, match=rf"{short}_0000 should have 120 rows, got the shape \(3,\)\); delete it"):
            open_pair_pool(tmp_path)

    def test_no_pool_is_a_clear_error(self, tmp_path):
        with pytest.raises(InputError, match="workbench train flow"):
            open_pair_pool(tmp_path)

    def test_some_expressions_stay_and_none_leaves_its_range(self, head):
        rng = np.random.default_rng(0)
        pairs = [random_expressions(head.expression_names, rng) for _ in range(200)]
        assert 0.08 < np.mean([np.array_equal(*pair) for pair in pairs]) < 0.35
        assert all((weights >= 0).all() and (weights <= 1).all() for pair in pairs for weights in pair)


@needs_gl
def test_a_rendered_pair_agrees_with_its_flow(head):
    studio = PairStudio(head, skin_painter(head))
    try:
        rng = np.random.default_rng(11)
        pair = studio.shoot(studio.cast(rng), rng)
    finally:
        studio.close()
    y, x = np.indices(pair.marks[0].shape).astype(np.float32)
    for k in (0, 1):
        flow = pair.flow[k].astype(np.float32)
        read = cv2.remap(pair.rgba[1 - k], x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR)
        counted = cv2.erode((pair.marks[k] & (VISIBLE | FACE) == VISIBLE | FACE).astype(np.uint8), np.ones((3, 3))) > 0
        assert counted.mean() > 0.05
        assert np.median(np.abs(read.astype(float) - pair.rgba[k])[counted]) < 8


class TestTask:
    def test_the_true_flow_costs_least(self, pool):
        task = FlowTask()
        rngs = [np.random.default_rng(k) for k in range(2)]
        pictures, targets = task.batch(pool, Phase(64, 1, 2, 1e-3), rngs)
        targets = tuple(torch.from_numpy(part) for part in targets)
        truth = targets[0].permute(0, 3, 1, 2)
        assert pictures.shape == (2, 64, 64, 6)
        levels = [torch.nn.functional.avg_pool2d(truth, factor) / factor for factor in (*LEVEL_FACTORS, 4)]
        right, numbers = task.loss(levels, targets)
        wrong, _ = task.loss([level + 1 for level in levels], targets)
        assert right < 0.5 * wrong
        assert numbers["face_px"] < 1.0

    def test_a_training_leaves_a_network_that_jax_reads(self, pool_folder, tmp_path):
        path = train(FlowTask(), pool_folder, tmp_path, PLAN, workers=0, report=lambda line: None)
        network = read_flow_network(path)
        assert [conv.weight.shape[0] for conv in network.d] == [4, 4, 6, 6]
        assert (tmp_path / "curves.csv").read_text().startswith("step,rate,loss,all_px,face_px")


class Still:
    """An estimator that sees no motion."""

    name = "still"

    def __call__(self, first, second):
        return np.zeros((*first.shape[:2], 2), np.float32)


def test_estimators_are_measured_on_the_same_pairs(pool):
    tables = measured_flow({"still": Still(), "dis": DisFlow()}, pool, 6, 96)
    assert set(tables) == {"clean", "damaged"}
    assert tables["clean"]["dis"]["face"] < 0.5 * tables["clean"]["still"]["face"]
    assert tables["clean"]["still"]["pairs"] == tables["clean"]["dis"]["pairs"] > 2
    assert "| clean: dis |" in flow_tables(tables)
    pair = augmented_pair(pool, 0, np.random.default_rng(0), 96, CLEAN)
    assert end_point_error(pair.flow, pair.flow, pair.face).mean == 0
