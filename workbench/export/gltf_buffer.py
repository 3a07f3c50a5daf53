"""The binary part of a glTF file."""

from dataclasses import dataclass, field

import numpy as np

from workbench.extras import needs

with needs("formats"):
    import pygltflib

VERTICES = pygltflib.ARRAY_BUFFER
INDICES = pygltflib.ELEMENT_ARRAY_BUFFER
COMPONENTS = {
    np.dtype(np.float32): pygltflib.FLOAT,
    np.dtype(np.uint8): pygltflib.UNSIGNED_BYTE,
    np.dtype(np.uint16): pygltflib.UNSIGNED_SHORT,
    np.dtype(np.uint32): pygltflib.UNSIGNED_INT,
}
KINDS = {(): pygltflib.SCALAR, (2,): pygltflib.VEC2, (3,): pygltflib.VEC3, (4,): pygltflib.VEC4, (4, 4): pygltflib.MAT4}


@dataclass
class Buffer:
    """Bytes, with what describes them."""

    data: bytearray = field(default_factory=bytearray)
    views: list[pygltflib.BufferView] = field(default_factory=list)
    accessors: list[pygltflib.Accessor] = field(default_factory=list)

    def view(self, content: bytes, target: int | None = None) -> int:
        """Bytes as a new view, aligned to four; `target` says whether they are vertices or indices."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        place = {"byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append(pygltflib.BufferView(buffer=0, target=target, **place))
        self.data.extend(content)
        return len(self.views) - 1

    def add(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """An array as a new accessor; floating-point numbers in single precision."""
        if np.issubdtype(values.dtype, np.floating):
            values = values.astype(np.float32)
        values = np.ascontiguousarray(values)
        accessor = pygltflib.Accessor(
            bufferView=self.view(values.tobytes(), target),
            componentType=COMPONENTS[values.dtype],
            count=len(values),
            type=KINDS[values.shape[1:]],
        )
        if bounds:
            accessor.min = np.atleast_1d(values.min(0)).astype(float).tolist()
            accessor.max = np.atleast_1d(values.max(0)).astype(float).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def zeros(self, count: int) -> int:
        """An accessor of so many vectors of three zeros, which takes no bytes."""
        accessor = pygltflib.Accessor(
            byteOffset=None,
            componentType=pygltflib.FLOAT,
            count=count,
            type=pygltflib.VEC3,
            min=[0.0] * 3,
            max=[0.0] * 3,
        )
        self.accessors.append(accessor)
        return len(self.accessors) - 1
