"""What the README and the documentation promise exists and runs."""

import re
import shlex
from pathlib import Path
from typing import get_args

import pytest
from typer.main import get_command

import workbench
from tests.pages import EVERYTHING, PAGES, ROOT, snippet
from workbench.cli import app
from workbench.config import PRESETS, InfillConfig, LandmarksConfig, RefinementConfig
from workbench.pipeline import OUTPUTS
from workbench.samples import sample

COMMANDS = sorted(set(re.findall(r"^(?:\.venv/bin/)?(workbench [^#\n]*)", EVERYTHING, re.M)))
TARGETS = sorted(set(re.findall(r"^make ([\w-]+)", EVERYTHING, re.M)))
LINKS = sorted({(page, link) for page, text in PAGES.items() for link in re.findall(r"\]\(([^)#]+)\)", text)})


def parsed(command):
    """The values of a command line, as the command itself would read them."""
    leaf, words = get_command(app), shlex.split(command)[1:]
    while hasattr(leaf, "commands"):
        leaf = leaf.commands[words.pop(0)]
    return leaf.make_context(leaf.name, words).params


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_line_is_parsed_with_all_its_values(command):
    """Unknown commands, options and choices, and missing values, raise."""
    given = parsed(command)
    assert given.get("preset_name") in (None, *PRESETS)
    assert given.get("detector") in (None, *get_args(LandmarksConfig.model_fields["detector"].annotation))
    assert given.get("infill") in (None, *get_args(InfillConfig.model_fields["method"].annotation))
    assert given.get("refine") in (None, *get_args(RefinementConfig.model_fields["method"].annotation))


@pytest.mark.parametrize("page", ["README.md", "docs/guides/track.md"])
def test_the_runs_of_a_page_work_in_their_order(page):
    """A folder that holds a run takes another one only to continue or to replace it."""
    taken = set()
    for command in re.findall(r"^(workbench track [^#\n]*)", PAGES[page], re.M):
        given = parsed(command)
        folder = given["out"] or Path("out") / given["inputs"][0].stem
        assert folder not in taken or given["resume"] or given["overwrite"], command
        taken.add(folder)
    assert len(taken) >= 5


@pytest.mark.parametrize("target", TARGETS)
def test_every_make_target_exists(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)


def test_there_are_commands_to_check():
    assert len(COMMANDS) >= 40
    assert {"lab", "test", "demo", "docs"} <= set(TARGETS)


def test_the_first_snippet_fits_one_picture():
    names = {}
    exec(
        compile(
            snippet("workbench.fit(").replace('"portrait.jpg"', f'r"{sample("astronaut")}"'), "documentation", "exec"
        ),
        names,
    )
    assert names["fit"].weights["mouthSmileLeft"] > 0.2
    assert len(names["mesh"][0]) == names["mesh"][1].max() + 1
    assert len(names["figure"].axes) == 2


def test_the_panel_snippet_runs():
    text = snippet("TuningPanel")
    text = text.replace('"talk.mp4"', f'r"{sample("astronaut-landmarks")}"')
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    assert names["panel"].wait_idle(300)
    assert names["panel"].fit.found
    names["panel"].close()


def test_the_live_snippet_runs():
    names = {}
    exec(compile(snippet("LivePanel"), "documentation", "exec"), names)
    assert not names["panel"].running
    names["panel"].close()


def test_the_tracking_snippet_runs(tmp_path):
    text = snippet("smile")
    text = text.replace('"talk.mp4", "out/talk"', f'r"{sample("astronaut-landmarks")}", r"{tmp_path}"')
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    assert names["smile"].shape == (1,)
    assert names["smile"][0] > 0.2


@pytest.mark.long
def test_the_deep_energies_snippet_runs():
    text = snippet("stage_strip")
    text = text.replace('"talk.mp4"', f'r"{sample("astronaut")}"').replace("(12)", "(0)")
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    assert names["fit"].jaw.shape == (6,)
    assert names["fit"].failure == ""
    assert names["strip"].shape[2] == 3
    assert names["session"].config.deep.energy == "points"


def test_the_infill_snippet_runs(tmp_path):
    clip = sample("performance")
    workbench.track(clip, tmp_path, workbench.load_default_head(), workbench.preset("joint"), pictures=False,
                    landmarks=sample("performance-landmarks"), frames=(0, 8))  # fmt: skip
    text = snippet("work_over")
    text = text.replace('"out/talk/track.npz"', f'r"{tmp_path / "track.npz"}"').replace('"talk.mp4"', f'r"{clip}"')
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    assert [names["filled"][k].source for k in (3, 4, 5, 6)] == ["given", "filled", "filled", "given"]


def test_every_output_file_is_described():
    for name in OUTPUTS:
        assert f"`{name}`" in EVERYTHING


@pytest.mark.parametrize(("page", "link"), LINKS)
def test_links_lead_to_files(page, link):
    if not link.startswith("http"):
        assert (ROOT / page).parent.joinpath(link).exists()


def test_the_readme_is_short():
    assert len(PAGES["README.md"].encode()) <= 9 * 1024


def test_every_bundled_file_has_its_source_stated():
    stated = (ROOT / "data_samples" / "SOURCES.md").read_text(encoding="utf-8")
    for path in (ROOT / "data_samples").iterdir():
        if path.is_file() and path.suffix in {".png", ".jpg", ".mp4", ".csv", ".npz"}:
            assert f"`{path.name}`" in stated
    assert (ROOT / "data_samples" / "head" / "LICENSE-CC0.txt").is_file()


def test_the_face_model_snippet_runs(tmp_path):
    text = snippet("generic_model.pkl")
    for written, meant in {
        "generic_model.pkl": sample("head"),
        "talk.mp4": sample("astronaut-landmarks"),
        "out/flame": tmp_path,
    }.items():
        text = text.replace(f'"{written}"', f'r"{meant}"')
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    assert names["result"].summary["frames_with_face"] == 1


def test_the_flow_snippet_runs():
    text = snippet("bundled_flow")
    text = text.replace('"talk.mp4"', f'r"{sample("performance")}"')
    names = {}
    exec(compile(text, "documentation", "exec"), names)
    height, width = names["first"].shape[:2]
    assert names["flow"].shape == (height, width, 2)
    assert names["colors"].shape == (height, width, 3)
    assert names["hidden"].mean() < 0.5
    assert names["difference"].shape == (height, width)
