"""Processor time of a picture of each character as a multiple of one of the plain head."""

import time

import numpy as np
from result import print_result

from workbench.face import character_names, load_character, load_default_head, posed_vertices
from workbench.pictures import HeadRenderer, portrait_view

SIZE = (480, 480)
ROUNDS = 5


def main() -> None:
    """Print the median character's time as a multiple of the plain head's."""
    times = {name: drawn_ms(name) for name in (None, *character_names())}
    plain = times.pop(None)
    middle = float(np.median(list(times.values())))
    print_result("characters_drawn", middle / plain, "x", None, "the plain head", {"plain_ms": plain, "ms": times})


def drawn_ms(name: str | None) -> float:
    """Processor milliseconds of the quickest of some pictures, after one that compiles the shaders."""
    dressed = None if name is None else load_character(name)
    person = load_default_head() if dressed is None else dressed.person
    camera, translation = portrait_view(person, SIZE)
    vertices = posed_vertices(person, np.zeros(len(person.expression_names)), np.zeros(6))
    found = []
    with HeadRenderer(person, SIZE, fade_neck=True, dressed=dressed) as renderer:
        for k in range(ROUNDS + 1):
            began = time.process_time()
            renderer.render(vertices, camera, np.array([0.0, 0.1 * k, 0.0]), translation)
            found.append(1e3 * (time.process_time() - began))
    return min(found[1:])


if __name__ == "__main__":
    main()
