"""A video through MediaPipe's face mesh, for `video_rate_peers.py`: times of a frame, decoding included.

Runs under an interpreter that has MediaPipe: `python mediapipe_rate.py VIDEO`. Prints one line of JSON.
"""

import json
import sys
import time
from collections.abc import Iterator

import cv2
import mediapipe
import numpy as np


def main() -> None:
    """Track the face as in a video, with the graph built and the first frame seen before the clock starts."""
    with mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=False, max_num_faces=1) as mesh:
        mesh.process(next(pictures(sys.argv[1])))
        wall, processor = time.perf_counter(), time.process_time()
        found = [mesh.process(picture).multi_face_landmarks is not None for picture in pictures(sys.argv[1])]
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
    times = {"wall_ms": 1e3 * wall / len(found), "processor_ms": 1e3 * processor / len(found)}
    print(json.dumps(times | {"frames": len(found), "frames_with_face": sum(found)}))


def pictures(video: str) -> Iterator[np.ndarray]:
    """The frames in RGB, as MediaPipe wants them."""
    capture = cv2.VideoCapture(video)
    while True:
        read, picture = capture.read()
        if not read:
            return
        yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


if __name__ == "__main__":
    main()
