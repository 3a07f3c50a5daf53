"""The figures, tables and experiments of the papers that can be remade, a row each. Data alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from workbench.errors import InputError

FACE_IT, DEEP_ENERGIES = "FACE IT!", "Deep Energies"


@dataclass(frozen=True)
class Item:
    """One of them."""

    name: str
    """On the command line."""
    paper: str
    place: str
    title: str
    make: str
    """Module and function in this package: `Study` -> `Result`. A name, so that items can be listed at once."""
    printed: str
    """What the paper reports, in a sentence."""
    reads_set: bool = False
    """Whether it reads Boston University's set and poses of other programs on it."""
    reads_clip: bool = False
    """Whether it works on a clip of the user's, if there is one."""
    shares: str = ""
    """Name of the item in whose folder it keeps things and finds what others kept; its own if empty."""
    reads_meshes: bool = False
    """Whether it reads meshes of other programs."""


ITEMS = (
    Item(
        name="overview",
        paper=FACE_IT,
        place="Fig. 1",
        title="From a frame to pose and weights",
        make="face_it:overview",
        printed="A diagram: landmarks by regression trees and optical flow, head pose, expression, a character's face.",
    ),
    Item(
        name="beta-curve",
        paper=FACE_IT,
        place="Fig. 2",
        title="The range function E_β",
        make="face_it:beta_curve",
        printed="Two smooth steps that leave weights in [0, 1] free: a = 1.002, b = 2·10⁻⁵, c = 2.5.",
    ),
    Item(
        name="cases",
        paper=FACE_IT,
        place="Fig. 3",
        title="Twelve cases",
        make="cases:sheet",
        printed="Photos of several people with large poses, expressions, low light and occlusions, and the faces of a "
        "character that follow them.",
    ),
    Item(
        name="iterations",
        paper=FACE_IT,
        place="Fig. 4, left",
        title="Iterations of pose and expression",
        make="face_it:iterations",
        printed="The pose needs about 15 iterations to converge; the expression does not converge within 50, but 15 "
        "are enough to transfer similar expressions.",
    ),
    Item(
        name="iteration-times",
        paper=FACE_IT,
        place="Fig. 4, right",
        title="Time against ρ and ε",
        make="face_it:iteration_times",
        printed="A plot of the time of the energy minimisation for ρ and ε up to 50, over about 1,000 frames.",
    ),
    Item(
        name="runtime",
        paper=FACE_IT,
        place="Sec. 5",
        title="Runtime",
        make="face_it:runtime",
        printed="18 frames per second over about 1,000 frames of 640 × 480 on an Intel Xeon W3520: 23.7 ms for the "
        "landmarks and 31.6 ms for the energy per frame.",
    ),
    Item(
        name="head-pose",
        paper=FACE_IT,
        place="Table 1",
        title="Head pose on Boston University's set",
        make="face_it:head_pose",
        printed="Mean absolute errors of 2.35° (roll), 3.62° (pitch) and 4.38° (yaw), 3.45° on average; 2.27, 0.90 and "
        "2.04 inches along X, Y and Z.",
        reads_set=True,
    ),
    Item(
        name="face-it-differences",
        paper=FACE_IT,
        place="the whole",
        title="What our differences from the paper are worth",
        make="differences:face_it",
        printed="No values of ω; pictures of fits, no errors of the weights.",
    ),
    Item(
        name="missed-faces",
        paper=DEEP_ENERGIES,
        place="Sec. 6",
        title="Frames in which face detectors find nothing",
        make="face_detectors:missed_frames",
        printed="On the test sequence dlib's HOG detector fails on 20 frames, its CNN on none.",
    ),
    Item(
        name="stages",
        paper=DEEP_ENERGIES,
        place="Figs. 3–6",
        title="The stages of a frame",
        make="deep_energies:stages",
        printed="Strips of real frames. The rigid alignment overfits to the mouth's landmarks, which is corrected "
        "as soon as the jaw may open.",
    ),
    Item(
        name="wrong-markers",
        paper=DEEP_ENERGIES,
        place="Fig. 7",
        title="A worked failure",
        make="wrong_markers:worked_failure",
        printed="Erroneous markers, as around the jaw, lead to an inaccurate local minimum. Such frames are left to "
        "infill by optical flow, or the markers are removed, which may overfit to those of the mouth.",
    ),
    Item(
        name="seen-or-preselected",
        paper=DEEP_ENERGIES,
        place="Fig. 19",
        title="Landmarks seen in the render against points on the mesh",
        make="deep_energies:seen_or_preselected",
        printed="Strips of both after the expression stages: what the network sees in the render takes longer and "
        "generally aligns the head better than preselected points, which find some frames' expression better at the "
        "cost of the pose.",
    ),
    Item(
        name="film-infill",
        paper=DEEP_ENERGIES,
        place="Figs. 8, 13",
        title="Gaps of a film filled by flow and by interpolation",
        make="through_time:infill",
        printed="Strips of three frames between two solved ones, a mouth that stays open and then snaps shut: flow "
        "keeps the mouth open longer than interpolation does, and matches lips and contour better. No numbers.",
    ),
    Item(
        name="film-flow-forms",
        paper=DEEP_ENERGIES,
        place="Sec. 6",
        title="The flow of the renders: exact, estimated, or with the network's derivative",
        make="through_time:flow_forms",
        printed="One form: FlowNet2 on photos and renders of 512 × 512 pixels, with its own derivative. No numbers.",
        shares="film-infill",
    ),
    Item(
        name="film-alignment",
        paper=DEEP_ENERGIES,
        place="Sec. 8.4",
        title="Every frame of a film on its own, by one camera and by two",
        make="through_time:alignment",
        printed="Overlays beside a matchmove artist's alignment: visually comparable. Rotations alike by one camera "
        "and by two, translations much more accurate by two (Fig. 10). No numbers.",
        shares="film-infill",
    ),
    Item(
        name="rigid-alignment",
        paper=DEEP_ENERGIES,
        place="Fig. 9",
        title="The rigid alignment beside one by tracked dots",
        make="rigid_alignment:compared",
        printed="Strips of a manual alignment, a monocular and a stereo one: visually comparable. The manual one is "
        "likely to have errors as well.",
    ),
    Item(
        name="stereo",
        paper=DEEP_ENERGIES,
        place="Fig. 10",
        title="Rigid errors by one camera and by two",
        make="deep_energies:stereo",
        printed="Plots: rotations alike by one camera and by two; translations much more accurate by two.",
    ),
    Item(
        name="film-smoothing",
        paper=DEEP_ENERGIES,
        place="Figs. 11, 14–17",
        title="Four methods of temporal refinement on a film",
        make="through_time:smoothing",
        printed="Averaging is smooth, but no longer matches the picture; self flow has little effect on noise and "
        "still deviates; plate flow matches each frame, but adjacent frames may disagree; hybrid is smooth and "
        "matches, and does not increase the errors of the pose. Strips and plots, no numbers.",
        shares="film-infill",
    ),
    Item(
        name="film-reestimation",
        paper=DEEP_ENERGIES,
        place="Fig. 18, App. B.1",
        title="The expression re-estimated after refinement",
        make="through_time:reestimation",
        printed="Strips: generally more accurate than before the refinement, and where that dampens the performance, "
        "the expression is captured again.",
        shares="film-infill",
    ),
    Item(
        name="clip-through-time",
        paper=DEEP_ENERGIES,
        place="Secs. 6–8.5",
        title="Infill and refinement on a clip of yours",
        make="clip_through_time:hidden_frames",
        printed="A real performance, 24 frames a second, numerous frames with motion blur: failed frames are filled, "
        "all are refined. Pictures and a video, no numbers.",
        reads_clip=True,
    ),
    Item(
        name="components",
        paper=DEEP_ENERGIES,
        place="App. C.2",
        title="Ten components each of shape and expression, no lens known",
        make="components:opening",
        printed="Pictures: Basel's model by parallel projection beside 3DDFA, VRN and PRNet.",
    ),
    Item(
        name="other-meshes",
        paper=DEEP_ENERGIES,
        place="Figs. 12 and 20",
        title="Other programs' meshes beside ours",
        make="other_meshes:compared",
        printed="3DDFA aligns the face wrongly; VRN and PRNet align it better and do not fully open the mouth; Basel's "
        "model by parallel projection neither; the actor's own model is the only one that captures the expression.",
        reads_meshes=True,
    ),
    Item(
        name="deep-differences",
        paper=DEEP_ENERGIES,
        place="the whole",
        title="What our differences from the paper are worth",
        make="differences:deep_energies",
        printed="λ = 100, errors in pixels, the derivative by the chain rule.",
    ),
)


def choose(names: Sequence[str]) -> tuple[Item, ...]:
    """The items with these names, in the papers' order; all of them for none. Raises `InputError` for unknown names."""
    known = {item.name for item in ITEMS}
    for name in names:
        if name not in known:
            raise InputError(f"There is no item {name!r}; `workbench reproduce --list` names them.")
    return tuple(item for item in ITEMS if not names or item.name in names)
