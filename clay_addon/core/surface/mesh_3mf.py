# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing 3MF, a file format for 3D printing: one mesh in millimeters, with vertex colors.

Follows the *3MF Core Specification* 1.3 and the *Materials and Properties Extension* 1.2.1 of the
3MF Consortium. The text is written to the archive in chunks, to limit memory use.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from typing import IO

import numpy as np
from numpy.typing import NDArray

_CONTENT_TYPES = """\
<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIPS = """\
<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" \
xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" \
xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02">
<metadata name="Application">Tactile Clay</metadata>
<resources>
"""
_ROWS = 20_000
"""Number of vertices or faces per chunk of text."""


def write_3mf(
    file: IO[bytes],
    vertices: NDArray[np.float32],
    faces: NDArray[np.int64],
    colors: NDArray[np.uint8] | None = None,
) -> None:
    """Write a closed mesh as 3MF.

    Args:
        file: A file opened for writing.
        vertices: Positions [mm], shape [V, 3].
        faces: Vertex indices, counter-clockwise seen from outside, shape [F, 3].
        colors: sRGB and alpha of the vertices, shape [V, 4].
    """
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr("[Content_Types].xml", _CONTENT_TYPES)
        archive.writestr("_rels/.rels", _RELATIONSHIPS)
        with archive.open("3D/3dmodel.model", "w", force_zip64=True) as model:
            for part in _model(vertices, faces, colors):
                model.write(part.encode("ascii"))


def _model(
    vertices: NDArray[np.float32], faces: NDArray[np.int64], colors: NDArray[np.uint8] | None
) -> Iterator[str]:
    yield _HEAD
    of_vertex = np.zeros(len(vertices), np.int64)
    attributes = ""
    if colors is not None:
        packed = np.ascontiguousarray(colors).view(">u4").ravel()
        palette, of_vertex = np.unique(packed, return_inverse=True)
        yield '<m:colorgroup id="1">\n'
        yield from _lines(f'<m:color color="#{value:08X}"/>' for value in palette.tolist())
        yield "</m:colorgroup>\n"
        attributes = ' pid="1" pindex="0"'
    yield f'<object id="2" type="model" name="Clay"{attributes}>\n<mesh>\n<vertices>\n'
    # Nine digits represent single precision exactly.
    for rows in _chunks(vertices):
        yield from _lines(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in rows)
    yield "</vertices>\n<triangles>\n"
    for start in range(0, len(faces), _ROWS):
        part = faces[start : start + _ROWS]
        if colors is None:
            yield from _lines(
                f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in part.tolist()
            )
            continue
        both = np.concatenate([part, of_vertex[part]], axis=1).tolist()
        yield from _lines(
            f'<triangle v1="{a}" v2="{b}" v3="{c}" pid="1" p1="{p}" p2="{q}" p3="{r}"/>'
            for a, b, c, p, q, r in both
        )
    yield "</triangles>\n</mesh>\n</object>\n</resources>\n"
    yield '<build>\n<item objectid="2"/>\n</build>\n</model>\n'


def _chunks(values: NDArray[np.float32]) -> Iterator[list[list[float]]]:
    for start in range(0, len(values), _ROWS):
        yield values[start : start + _ROWS].tolist()


def _lines(lines: Iterator[str]) -> Iterator[str]:
    text = "\n".join(lines)
    if text:
        yield text + "\n"
