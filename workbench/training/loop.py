"""Training: the plan, the loop with its checkpoints and curves, and the export to safetensors."""

import csv
import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from workbench.errors import InputError
from workbench.files import atomic_path, writing
from workbench.landmarks.schemes import DensePoints
from workbench.networks.encoder import BLOCKS, WIDTHS, network_size
from workbench.networks.weights import ARCHITECTURE, read_weights, write_weights
from workbench.reading import checked_json, reading, shortened
from workbench.training import PLAN_FILE
from workbench.training.batch_studio import BatchStudio
from workbench.training.pool import Pool, open_pool
from workbench.training.torch_network import TorchLandmarkNetwork, conv_norms, go_on_from

AVERAGING = 0.998
"""Decay per step of the moving average of the weights, which is what is kept."""
STEP = "step"
"""The first column of the curves."""
UNREADABLE = "\N{REPLACEMENT CHARACTER}"
"""What stands for bytes that are no text."""
CHECKPOINT = "a training's checkpoint", "add --overwrite to train again; the pool is kept"
"""What a checkpoint should be, and what to do where it is not."""


@dataclass(frozen=True)
class Phase:
    """Some steps at one input size; the network is convolutional, so most is learned on small, quick pictures."""

    input_side: int
    steps: int
    batch: int
    peak_rate: float


@dataclass(frozen=True)
class TrainingPlan:
    """All that decides the weights."""

    phases: tuple[Phase, ...]
    widths: tuple[int, int, int, int] = (32, 64, 128, 192)
    blocks: int = 2
    seed: int = 1
    weight_decay: float = 1e-4
    start: str = ""
    """SHA-256 of the weights that it began with; empty: random ones."""
    batched: bool = False
    """Whether pictures are made in whole batches where the network computes (`training/batch_studio.py`), or one by
    one by worker processes."""
    learned: float = 1.0
    """Share of what was learned in the weights that are kept, the rest being what it began with: a short training on
    few people makes worse what it was not meant for, and the mean of both hardly does (Wortsman et al., CVPR 2022)."""
    pictures: int | None = None
    """Pictures (or pairs) of the pool that it learns from, as `open_pool` takes them; None: all that are there."""

    @property
    def steps(self) -> int:
        """Steps of all phases together."""
        return sum(phase.steps for phase in self.phases)

    def at(self, step: int) -> tuple[Phase, int]:
        """The phase of a step, and the step's place in it."""
        for phase in self.phases:
            if step < phase.steps:
                return phase, step
            step -= phase.steps
        raise InputError(f"the plan has {self.steps} steps, so there is no step {step + self.steps}")

    def rate(self, step: int) -> float:
        """Learning rate: a short rise, then half a cosine down to a fiftieth, in each phase."""
        phase, place = self.at(step)
        rise = min(1.0, (place + 1) / max(1, min(300, phase.steps // 10)))
        fall = 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * place / phase.steps))
        return phase.peak_rate * rise * fall


Batch = tuple[UInt8[np.ndarray, "n s s channels"], tuple[np.ndarray, ...]]
"""Pictures (or pairs: six channels), and what is known of them."""


@runtime_checkable
class Task(Protocol):
    """What is learned, from which pool, by which network, and what is kept of it."""

    architecture: str

    def open(self, folder: Path, pictures: int | None) -> Any: ...

    def network(self, plan: TrainingPlan) -> nn.Module: ...

    def arrays(self, network: nn.Module) -> dict[str, np.ndarray]: ...

    def batch(self, pool: Any, phase: Phase, rngs: list[np.random.Generator]) -> Batch: ...

    def loss(self, answers: Any, targets: tuple[Tensor, ...]) -> tuple[Tensor, dict[str, Tensor]]: ...


@runtime_checkable
class FurtherTask(Task, Protocol):
    """A task that can start from weights."""

    @property
    def starts(self) -> tuple[str, ...]:
        """The architectures whose weights it can start from."""

    def begin(self, network: nn.Module, start: Path, pictures: Tensor) -> None: ...


@runtime_checkable
class FaceTask(Protocol):
    """A task that learns from pictures of single faces, so that whole batches of them can be made at once."""

    dense: DensePoints | None
    """The points beyond the 68 landmarks and the pupils that it learns, too."""


@dataclass(frozen=True)
class MapsTask:
    """What the tasks of the landmark network's architecture share."""

    architecture: str
    outputs: int
    output_scale: float = 1.0

    @property
    def starts(self) -> tuple[str, ...]:
        """Only those of the same kind."""
        return (self.architecture,)

    def open(self, folder: Path, pictures: int | None) -> Pool:
        """The pool that batches are made of."""
        return open_pool(folder, pictures)

    def network(self, plan: TrainingPlan) -> nn.Module:
        """An untrained one."""
        return TorchLandmarkNetwork(plan.widths, plan.blocks, self.outputs)

    def begin(self, network: nn.Module, start: Path, pictures: Tensor) -> None:
        """Give the network the weights of a file; `pictures` are some of those to come."""
        go_on_from(network, read_weights(start).arrays, pictures, self.output_scale)

    def arrays(self, network: nn.Module) -> dict[str, np.ndarray]:
        """What is kept of a trained one."""
        return folded_arrays(network, self.output_scale)


@dataclass(frozen=True)
class _Batches(torch.utils.data.Dataset):
    """Batches by step: the same whoever makes them, in whatever order."""

    task: Task
    pool_folder: Path
    plan: TrainingPlan
    first_step: int

    def __len__(self) -> int:
        return self.plan.steps - self.first_step

    def __getitem__(self, offset: int) -> Batch:
        step = self.first_step + offset
        phase, _ = self.plan.at(step)
        rngs = [np.random.default_rng([self.plan.seed, step, place]) for place in range(phase.batch)]
        return self.task.batch(_pool_of_process(self.task, self.pool_folder, self.plan.pictures), phase, rngs)


_POOLS: dict[tuple[Path, int | None], Any] = {}


def _pool_of_process(task: Task, folder: Path, pictures: int | None) -> Any:
    key = folder, pictures
    if key not in _POOLS:
        cv2.setNumThreads(1)
        _POOLS[key] = task.open(folder, pictures)
    return _POOLS[key]


def train(
    task: Task,
    pool_folder: Path,
    folder: Path,
    plan: TrainingPlan,
    workers: int = 2,
    device: str = "cpu",
    every: int = 250,
    report: Callable[[str], None] = print,
    start: Path | None = None,
) -> Path:
    """Run the plan from wherever `folder` stands, and write `weights.safetensors` there.

    The folder keeps the plan, a checkpoint every `every` steps and the curves; an interrupted training goes on from
    its last checkpoint when it is called again. The training pictures depend on the plan's seed and the step alone, so
    an interruption does not change them. `start`: weights to begin with instead of random ones. Raises as
    `checked_plan` does, before anything is written.
    """
    plan = checked_plan(task, folder, plan, device, start)
    _write_plan(folder / PLAN_FILE, plan)
    torch.manual_seed(plan.seed)
    network = task.network(plan)
    if start is not None and not (folder / "checkpoint.pt").is_file():
        first, _ = next(_pictures(task, pool_folder, replace(plan, batched=False), 0, 0, "cpu"))
        task.begin(network, start, first)
    network = network.to(device).to(memory_format=torch.channels_last)
    average = {name: value.detach().clone().float() for name, value in network.state_dict().items()}
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-3, weight_decay=plan.weight_decay)
    running: dict[str, Tensor] = {}
    step = _resumed(folder / "checkpoint.pt", network, optimiser, average, running)
    _forget_later_rows(folder / "curves.csv", step)
    began, first = time.monotonic(), step
    for pictures, targets in _pictures(task, pool_folder, plan, step, workers, device):
        for group in optimiser.param_groups:
            group["lr"] = plan.rate(step)
        with torch.autocast(device, torch.bfloat16):
            answers = network(pictures.contiguous(memory_format=torch.channels_last))
        answers = [part.float() for part in answers] if isinstance(answers, list) else answers.float()
        loss, numbers = task.loss(answers, targets)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        decay = min(AVERAGING, (step + 1) / (step + 10))
        with torch.no_grad():
            for name, value in network.state_dict().items():
                average[name].lerp_(value.float(), 1 - decay)
        # The device is not waited for until its numbers are shown.
        for name, value in numbers.items():
            running[name] = 0.98 * running.get(name, value) + 0.02 * value
        step += 1
        if step % 50 == 0 or step == plan.steps:
            speed = (step - first) / (time.monotonic() - began)
            _log(folder / "curves.csv", step, plan.rate(step - 1), running)
            numbers_text = ", ".join(f"{name} {value:.3f}" for name, value in running.items())
            report(f"step {step} of {plan.steps}: {numbers_text}; {speed:.2f} steps/s")
        if step % every == 0 or step == plan.steps:
            _save(folder / "checkpoint.pt", network, optimiser, average, running, step)
    return export_weights(task, folder, start=start)


def checked_plan(
    task: Task, folder: Path, plan: TrainingPlan, device: str = "cpu", start: Path | None = None
) -> TrainingPlan:
    """The plan with what it starts from, once it is clear that the task can follow it there; nothing is written.

    Raises `InputError` for a device that is not there, weights that the task cannot start from, a plan of whole batches
    that it cannot follow, and where the folder belongs to another plan.
    """
    check_device(device)
    if plan.batched and (not isinstance(task, FaceTask) or len({phase.input_side for phase in plan.phases}) > 1):
        raise InputError("whole batches are made of single faces at one size: choose another plan for this network")
    if start is not None:
        check_start(task, plan, start)
        plan = replace(plan, start=hashlib.sha256(start.read_bytes()).hexdigest())
    if (folder / PLAN_FILE).is_file() and not _follows(plan, read_plan(folder / PLAN_FILE)):
        raise InputError(
            f"{folder} holds a training with other options (--quick, --start, --device); use those again, name another "
            "folder, or discard it with --overwrite."
        )
    return plan


def _follows(plan: TrainingPlan, stored: TrainingPlan) -> bool:
    """Whether a training goes on by this plan; older ones did not store their pictures."""
    return stored == (plan if stored.pictures is not None else replace(plan, pictures=None))


def check_device(device: str) -> None:
    """Raise `InputError` unless PyTorch can compute there: "cpu", or "cuda" where it finds a GPU."""
    if device not in ("cpu", "cuda"):
        raise InputError(f"a training computes on cpu or cuda, got {shortened(device)}: name one of these")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError(
            "PyTorch finds no CUDA device here; leave out --device, or install a build of PyTorch for CUDA."
        )


def check_start(task: FurtherTask, plan: TrainingPlan, start: Path) -> None:
    """Raise `InputError` for weights of an architecture or a size that this training cannot start from."""
    weights = read_weights(start)
    if weights.architecture not in task.starts:
        raise InputError(
            f"{start} holds {shortened(weights.architecture)}, expected {' or '.join(task.starts)}: start from another"
        )
    widths, blocks = network_size(weights)
    if (widths, blocks) != (plan.widths, plan.blocks):
        raise InputError(
            f"{start} holds a network of {WIDTHS} {list(widths)} and {BLOCKS} {blocks}, expected {list(plan.widths)} "
            f"and {plan.blocks}: start from another"
        )


def export_weights(task: Task, folder: Path, metadata: dict[str, str] | None = None, start: Path | None = None) -> Path:
    """Fold the averaged weights of a training folder's checkpoint and write `weights.safetensors` beside it.

    `start`: the weights that it began with, which a plan may keep a share of; what they lack is kept as learned.
    """
    plan = read_plan(folder / PLAN_FILE)
    network = task.network(plan)
    with reading(folder / "checkpoint.pt", *CHECKPOINT):
        state = torch.load(folder / "checkpoint.pt", map_location="cpu", weights_only=True)
        network.load_state_dict(state["average"])
        origin = {"steps": str(state["step"]), "start": plan.start}
    arrays = task.arrays(network)
    if start is not None and plan.learned < 1.0:
        began = read_weights(start).arrays
        shared = arrays.keys() & began.keys()
        arrays |= {name: plan.learned * arrays[name] + (1.0 - plan.learned) * began[name] for name in shared}
    size = {WIDTHS: json.dumps(list(plan.widths)), BLOCKS: json.dumps(plan.blocks)}
    path = folder / "weights.safetensors"
    write_weights(path, arrays, {**(metadata or {}), ARCHITECTURE: task.architecture, **size, **origin})
    return path


def folded_arrays(network: TorchLandmarkNetwork, output_scale: float = 1.0) -> dict[str, np.ndarray]:
    """The inference network's arrays by name: normalisation folded, outputs scaled."""
    arrays: dict[str, Tensor] = {}
    for name, step in conv_norms(network):
        arrays[f"{name}.weight"], arrays[f"{name}.bias"] = step.folded()
    arrays["head.weight"], arrays["head.bias"] = network.head.weight * output_scale, network.head.bias * output_scale
    return kept(arrays)


def kept(arrays: dict[str, Tensor]) -> dict[str, np.ndarray]:
    """Tensors as what a weights file takes."""
    return {name: value.detach().float().contiguous().numpy() for name, value in arrays.items()}


def read_plan(path: Path) -> TrainingPlan:
    """The plan of a training folder. Raises `InputError` for a damaged one."""
    with reading(path, "the plan of a training", "repeat the command with --overwrite to train again"):
        record = checked_json(path.read_bytes())
        phases = tuple(Phase(**phase) for phase in record.pop("phases"))
        return TrainingPlan(phases=phases, widths=tuple(record.pop("widths")), **record)


def _write_plan(path: Path, plan: TrainingPlan) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(asdict(plan), indent=1), encoding="utf-8")


def _pictures(
    task: Task, pool_folder: Path, plan: TrainingPlan, step: int, workers: int, device: str
) -> Iterator[tuple[Tensor, tuple[Tensor, ...]]]:
    """The batches from a step on, on the device: pictures (n, channels, s, s) in 0..1, and what is known of them."""
    if step >= plan.steps:
        return
    if not plan.batched:
        for pictures, targets in _batches(task, pool_folder, plan, step, workers):
            yield (
                pictures.to(device).permute(0, 3, 1, 2).float().div_(255),
                tuple(target.to(device) for target in targets),
            )
        return
    pool = open_pool(pool_folder, plan.pictures)
    studio = BatchStudio(pool, plan.phases[0].input_side, task.dense, device, seed=plan.seed)
    for later in range(step, plan.steps):
        phase, _ = plan.at(later)
        yield studio.shoot(phase.batch, int(np.random.SeedSequence([plan.seed, later]).generate_state(1)[0]))


def _batches(task: Task, pool_folder: Path, plan: TrainingPlan, step: int, workers: int) -> Iterator[tuple]:
    loader = torch.utils.data.DataLoader(
        _Batches(task, pool_folder, plan, step),
        batch_size=None,
        shuffle=False,
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=_single_threaded if workers else None,
    )
    return iter(loader)


def _single_threaded(_worker: int) -> None:
    torch.set_num_threads(1)


def _resumed(path: Path, network, optimiser, average: dict[str, Tensor], running: dict[str, Tensor]) -> int:
    """The step of a checkpoint, 0 without one; network, optimiser and numbers become what they were there.

    Raises `InputError` for what is none of this network; some of them may have changed then.
    """
    if not path.is_file():
        return 0
    with reading(path, *CHECKPOINT):
        state = torch.load(path, map_location=next(network.parameters()).device, weights_only=True)
        network.load_state_dict(state["average"])  # this compares names and shapes
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        for name, value in state["average"].items():
            average[name].copy_(value)
        running.update(state.get("running", {}))  # older checkpoints have none
        return int(state["step"])


def _save(path: Path, network, optimiser, average, running: dict[str, Tensor], step: int) -> None:
    learned = {"network": network.state_dict(), "optimiser": optimiser.state_dict(), "average": average}
    state = {**learned, "running": running, "step": step}
    content = io.BytesIO()
    torch.save(state, content)  # PyTorch's own writer reports a full disk by an error of its own
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def _forget_later_rows(path: Path, step: int) -> None:
    """Leave the whole rows up to a step: an interrupted training repeats those after its last checkpoint.

    Of a damaged file those stay that can be read; without the names of its columns, none.
    """
    if not path.is_file():
        return
    with reading(path, "the curves of a training", "delete it; the training continues without the earlier curves"):
        lines = path.read_bytes().decode(errors="replace").splitlines()
    names, *rows = [line.split(",") for line in lines] or [[""]]
    if names[0] != STEP or UNREADABLE in "".join(names):
        with writing(path):
            path.unlink()
        return
    rows = [row for row in rows if len(row) == len(names) and _are_numbers(row) and int(row[0]) <= step]
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([names, *rows])


def _are_numbers(row: list[str]) -> bool:
    """Whether a row of the curves is whole: a step, and what was told of it."""
    try:
        return row[0].isascii() and row[0].isdigit() and all(isinstance(float(cell), float) for cell in row)
    except ValueError:
        return False


def _log(path: Path, step: int, rate: float, numbers: dict[str, Tensor]) -> None:
    fresh = not path.is_file()
    with writing(path), path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow([STEP, "rate", *numbers])
        writer.writerow([step, f"{rate:.3e}", *(f"{value:.4f}" for value in numbers.values())])
