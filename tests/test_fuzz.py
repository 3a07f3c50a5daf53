"""Damaged files of every format: what was meant, or one sentence; never another exception, a crash or endless work.

`pytest tests/test_fuzz.py --fuzz-inputs 20000` tries as many over all readers and prints the table of verdicts.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from tests import fuzzing_misreaders as misreaders
from tests.fuzz_readers import READERS
from tests.fuzzing import ACCEPTED, CLEAR, CRASH, GARBAGE, HANG, LEAKED, MEMORY, UNCLEAR, Files, Judge, Reader, Verdict
from tests.fuzzing_damage import damaged_files
from tests.selection import has_torch

SHOWN = 12
BY_PYTORCH = [pytest.mark.train, pytest.mark.skipif(not has_torch(), reason="PyTorch writes these files")]
TRIED = [
    pytest.param(reader, marks=BY_PYTORCH if "checkpoint" in reader.name else (), id=reader.name) for reader in READERS
]


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    with Judge(tmp_path_factory.mktemp("fuzz") / "input") as judge:
        yield judge


@pytest.fixture(scope="module")
def quick_judge(tmp_path_factory):
    with Judge(tmp_path_factory.mktemp("quick") / "input", longest_s=4.0) as judge:
        judge.warm_up(misreaders.accepting, {})
        yield judge


@pytest.mark.parametrize("reader", TRIED)
def test_damaged_files_are_read_or_refused_in_one_sentence(reader: Reader, judge, fuzz_tally, tmp_path):
    valid = reader.valid_files(tmp_path / "valid")
    judge.warm_up(reader.read, valid)
    failures: list[Verdict] = []

    @settings(
        max_examples=fuzz_tally.share_of(reader, READERS),
        phases=[Phase.generate],
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged_files(valid))
    def try_one(files):
        verdict = judge.verdict(reader.read, files)
        fuzz_tally.add(reader, verdict)
        if not verdict.good:
            failures.append(verdict)
            keep(files, tmp_path / f"input {len(failures)}")

    try_one()
    told = "\n".join(f"input {i}, {verdict.kind}: {verdict.said}" for i, verdict in enumerate(failures[:SHOWN], 1))
    assert not failures, f"{len(failures)} inputs fail, kept in {tmp_path}:\n{told}"


def keep(files: Files, folder: Path) -> None:
    """Write the files of an input for a closer look."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def test_the_names_of_readers_are_their_own():
    assert len({reader.name for reader in READERS}) == len(READERS)


# --- the judge itself ---


@pytest.mark.parametrize(
    ("read", "kind"),
    [
        (misreaders.leaking, LEAKED),
        (misreaders.making_no_sense, GARBAGE),
        (misreaders.rambling, UNCLEAR),
        (misreaders.greedy, MEMORY),
        (misreaders.never_ready, HANG),
        (misreaders.crashing, CRASH),
        (misreaders.refusing, CLEAR),
        (misreaders.accepting, ACCEPTED),
    ],
)
def test_the_judge_sees_what_must_not_be(read, kind, quick_judge):
    assert quick_judge.verdict(read, {"a.txt": b"a"}).kind == kind


def test_an_earlier_input_leaves_nothing_behind(quick_judge):
    for name in ("a.txt", "b.txt"):
        assert quick_judge.verdict(misreaders.finding_one_file, {f"folder/{name}": b""}).kind == ACCEPTED
