"""What each knob does in plain words: a name for those who have not read the papers, and the effect of raising it."""

from typing import NamedTuple


class Words(NamedTuple):
    """Plain words about a knob."""

    name: str
    """A few words, shown beside the paper's symbol."""
    effect: str
    """What happens when it is raised, switched on, or chosen."""


WORDS = {
    "weights.sparse": Words("all landmarks", "Higher: follows the points more closely, and their noise too."),
    "weights.pose": Words("points, pose only", "Higher: the pose stages trust the points more than the frame before."),
    "weights.fit": Words("points, expression", "Higher: the face follows the points; lower: it stays calmer."),
    "weights.prior": Words("all priors", "Higher: calmer and more plausible, but further from the points."),
    "weights.tau": Words("steady head", "Higher: the head shakes less, but lags behind quick turns."),
    "weights.beta": Words("range, as printed", "Higher: weights are pushed into 0 to 1, abruptly; can hold them at 0."),
    "weights.sigma": Words("few shapes, as printed", "Higher: fewer and weaker expressions, all scaled alike."),
    "weights.sigma_smooth": Words("few shapes", "Higher: fewer blendshapes at once, a calmer and flatter face."),
    "weights.range": Words("soft range", "Higher: weights below 0 and above 1 become rare."),
    "weights.vergence": Words("eyes together", "Higher: both eyes look the same way, even where one is seen badly."),
    "weights.opposites": Words("eyes one way", "Higher: no eye looks up and down, or in and out, at once."),
    "weights.gaze": Words("shut eyes hold", "Higher: eyes behind shut lids keep looking where they looked."),
    "weights.symmetry": Words("both sides alike", "Higher: no lopsided faces, but winks and smirks get weaker."),
    "weights.usual": Words("usual expressions", "Higher: shapes act as they do in most faces, and less in all."),
    "weights.flow": Words("follow the flow", "Higher: the face moves as the pixels do; flow errors come in too."),
    "rho": Words("pose iterations", "Higher: the pose settles better; each frame takes longer."),
    "epsilon": Words("expression iterations", "Higher: the expression settles better; each frame takes longer."),
    "solver.tolerance": Words("when to stop", "Higher: stops sooner, faster and less exact."),
    "solver.method": Words("how it solves", "Choose lm unless you compare solvers."),
    "solver.bounded": Words("hard range", "On: no weight leaves 0 to 1; off: weights may overshoot."),
    "landmarks.confidence": Words("trust of points", "On: points the detector doubts count less."),
    "solver.unit": Words("unit of residuals", "Percent: small and large faces need the same weights."),
    "contour.mode": Words("jaw on turned heads", "Sliding: the jaw line follows the visible outline."),
    "camera.fov_deg": Words("lens", "Higher: a wider lens; the head comes nearer, with more perspective."),
    "identity.calibrate": Words("person's shape", "On: measures this face first, so that weights start at rest."),
    "identity.weight": Words("near the mean face", "Higher: the person looks more average."),
    "identity.size": Words("near the mean size", "Higher: nearer to average size. Used where the lens is known."),
    "identity.expression": Words("neutral calibration", "Higher: differences count as the person's shape, not a mood."),
    "identity.jaw": Words("jaw in calibration", "Higher: the face outline decides more about the person's shape."),
    "constants.a": Words("upper end", "Higher: E_β allows larger weights."),
    "constants.b": Words("step width", "Higher: E_β rises gently; lower: like a wall."),
    "constants.c": Words("offset", "Moves the floor of E_β."),
    "constants.delta": Words("rounding of L1", "Higher: small weights are punished less and fewer become 0."),
    "constants.rotation_mm": Words("turn against shift", "Higher: E_τ holds turning more than shifting."),
    "constants.weighted_edges": Words("edges by trust", "On: an edge with a doubtful end counts less."),
    "deep.energy": Words("what is compared", "deep: what the network sees in photo and render; points: as FACE IT!."),
    "deep.network": Words("what looks at both", "dense: at 377 points of the whole face; the others: at 68."),
    "deep.derivative": Words("how it is derived", "forward is exact and slow; broyden is quicker and approximate."),
    "deep.start": Words("first pose", "landmarks: starts near the face; frontal: as the paper does."),
    "deep.edges": Words("shape of the lines", "Higher: lips and brows keep their shape better than their place."),
    "deep.regularisation": Words("towards neutral", "Higher: a calmer face, nearer to neutral."),
    "deep.prior": Words("near the start pose", "Higher: each stage moves the head less."),
    "deep.lambda_reading": Words("meaning of λ", "residual squares λ, so that the same number holds far more."),
    "deep.tolerance": Words("when to stop", "Higher: stages end sooner, faster and less exact."),
    "infill.method": Words("fill failed frames", "flow looks at the pictures; linear and spline do not."),
    "refinement.method": Words("steady the clip", "averaging is quick; plate and hybrid use the pictures."),
    "refinement.sweeps": Words("passes", "Higher: steadier, takes longer, flattens quick motion."),
    "refinement.reestimate": Words("new expressions", "Higher: expressions follow the steadied pose better."),
    "refinement.order": Words("order of frames", "gauss-seidel uses new poses at once; jacobi treats all alike."),
    "refinement.prior": Words("near the old pose", "Higher: less steadying."),
    "refinement.centre": Words("own share", "Higher: less steadying; 1 changes nothing."),
    "infill.passes": Words("way through a gap", "meet is quicker; back-and-forth is the paper's."),
    "infill.rounds": Words("passes through a gap", "Higher: both ends of a gap agree better; takes longer."),
    "infill.lids": Words("eyelids in a gap", "network sees blinks; flow hardly does."),
    "infill.largest_error": Words("failed above", "Higher: fewer frames count as failed."),
    "flow.estimator": Words("flow of the pictures", "dis is quick; network is our own, and slower."),
    "flow.renders": Words("flow of the renders", "exact is quickest; network is the paper's, and slow."),
    "flow.stay": Words("steady expression", "Higher: the expression moves less between frames."),
}
"""By path. A knob of a new term does without: it is called what its term says."""
GROUP = Words("trust of these points", "Higher: these points pull more; 0 leaves them out.")
OF_TERM = "Higher: this counts more relative to the landmarks."


def plain_words(path: str, says: str = "") -> Words:
    """Plain words about the knob at a path; `says` names one that has none here."""
    return GROUP if path.startswith("group.") else WORDS.get(path) or Words(says, OF_TERM)
