"""The recipes by the name of what they make: networks, and what expressions usually are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from workbench.errors import InputError
from workbench.training.dense_task import DenseTask
from workbench.training.expressions import QUICK_EXPRESSIONS, ExpressionRecipe, learn_expressions
from workbench.training.eye_task import EyeTask
from workbench.training.finder_task import FinderTask
from workbench.training.flow_recipe import QUICK_FLOW, FlowRecipe, train_flow_network
from workbench.training.landmark_task import LandmarkTask
from workbench.training.loop import FurtherTask, check_device, check_start
from workbench.training.recipe import (
    BATCHED,
    DENSE_PLAN,
    EYES,
    FINDER_PLAN,
    FURTHER_EYES,
    FURTHER_FINDER_PLAN,
    FURTHER_LANDMARKS,
    QUICK,
    QUICK_DENSE,
    QUICK_EYES,
    Recipe,
    learn_dense_gain,
    train_dense_network,
    train_eye_network,
    train_face_finder,
    train_landmark_network,
)

AnyRecipe = Recipe | FlowRecipe | ExpressionRecipe


@dataclass(frozen=True)
class Training:
    """A recipe, in its sizes."""

    make: Callable[..., Path]
    """Called with the folder, a recipe, the number of processes, the device and a function that hears of progress."""
    whole: AnyRecipe
    quick: AnyRecipe
    further: Recipe | None = None
    """For weights that are there already; None: it begins from nothing only."""
    task: FurtherTask | None = None
    """What learns further from them."""
    batched: Recipe | None = None
    """For a GPU, from nothing or from weights; None: the same as for a processor."""

    def recipe(self, quick: bool, start: Path | None, device: str = "cpu") -> AnyRecipe:
        """The recipe to follow. Raises `InputError` for weights to start from where there is no plan for going on."""
        on_gpu = self.batched if device != "cpu" else None
        if not start:
            return self.quick if quick else on_gpu or self.whole
        if quick or not self.further:
            raise InputError(f"{'a quick run' if quick else 'this training'} starts from scratch: leave out --start")
        return replace(on_gpu or self.further, start=start)

    def check(self, recipe: AnyRecipe, device: str) -> None:
        """Raise `InputError` for a device that is not there, and for weights that the recipe cannot start from."""
        check_device(device)
        if isinstance(recipe, Recipe) and recipe.start is not None and self.task is not None:
            check_start(self.task, recipe.plan, recipe.start)


TRAININGS: Mapping[str, Training] = MappingProxyType({
    "landmarks": Training(train_landmark_network, Recipe(), QUICK, FURTHER_LANDMARKS, LandmarkTask(), BATCHED),
    "finder": Training(
        train_face_finder, Recipe(plan=FINDER_PLAN), QUICK, Recipe(plan=FURTHER_FINDER_PLAN), FinderTask()
    ),
    "dense": Training(
        train_dense_network, Recipe(plan=DENSE_PLAN), QUICK_DENSE, Recipe(plan=DENSE_PLAN), DenseTask(), BATCHED
    ),
    "gain": Training(learn_dense_gain, Recipe(), QUICK),
    "eyes": Training(train_eye_network, EYES, QUICK_EYES, FURTHER_EYES, EyeTask()),
    "flow": Training(train_flow_network, FlowRecipe(), QUICK_FLOW),
    "expressions": Training(learn_expressions, ExpressionRecipe(), QUICK_EXPRESSIONS),
})  # fmt: skip
"""By what `workbench train` calls the network."""
