"""A road's reference line from straight lines and arcs, and where lane boundaries lie beside it.

Pieces of a reference line are rows x, y, heading, length, curvature; each begins where, and in the
direction in which, the one before it ends. Readers such as trajdata's know no other geometry than
lines and arcs.

Boundaries are measured along the line's normals. Lanes may end along a slanted line, so the
reference line turns at its ends until its normal goes through the corners: connected roads then
meet without a gap.
"""

from __future__ import annotations

import numpy as np
import shapely

from recast.arrays import Array

TOLERANCE = 0.02
"""Metres between the reference line and the line that it follows, where that does not slant."""
_CLOSEST = 0.05
"""Metres between points of the line that is followed: noise of closer ones turns tangents."""
_FLAT = 1e-4
"""Metres that an arc lies beside its chord, below which it is written as a straight line."""
_SLANT = 0.05
"""Radians between the normal of a line's end and the corners: more is turned in an arc of its own,
less within the fit."""
_OPEN = 1.25
"""Radius of that arc over the reach of the lanes, so that normals do not cross within them."""
_EVEN = 1e-6
"""Metres over a whole road that are not a slope."""
_MOST = 256
"""Points that two arcs follow at most: the time to fit them grows with the square of these."""
_MARGIN = 0.1
"""Metres added to that reach."""
_AT_ONCE = 1 << 18
"""Normals and pieces of a boundary whose crossings are computed at once."""
_SHORTEST = 0.5
"""Metres of that arc at least: the step at which trajdata looks up widths."""


def cleaned(line: Array) -> Array:
    """A polyline (N, 2 or 3) without points that nearly coincide, or turn back by over 90 degrees;
    its two ends are kept."""
    kept = [line[0]]
    for point in line[1:-1]:
        ahead, rest = (point - kept[-1])[:2], (line[-1] - point)[:2]
        if min(np.linalg.norm(ahead), np.linalg.norm(rest)) < _CLOSEST:
            continue
        if len(kept) > 1 and ahead @ (kept[-1] - kept[-2])[:2] <= 0:
            continue
        kept.append(point)
    while len(kept) > 1 and (line[-1] - kept[-1])[:2] @ (kept[-1] - kept[-2])[:2] <= 0:
        kept.pop()
    return np.array([*kept, line[-1]])


def tangents(points: Array) -> Array:
    """(N, 2) unit directions at the points of a polyline: those of the circle through a point and
    its neighbours."""
    steps = np.diff(points, axis=0)
    lengths = np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    ways = steps / lengths
    if len(points) == 2:
        return np.repeat(ways, 2, axis=0)
    inner = ways[:-1] * lengths[1:] + ways[1:] * lengths[:-1]
    inner /= np.maximum(np.linalg.norm(inner, axis=1, keepdims=True), 1e-12)
    ends = [2 * (w @ t) * w - t for w, t in ((ways[0], inner[0]), (ways[-1], inner[-1]))]
    return np.concatenate([ends[:1], inner, ends[1:]])


def direction(heading: float) -> Array:
    """The unit vector of a heading."""
    return np.array([np.cos(heading), np.sin(heading)])


def heading_of(way: Array) -> float:
    """The heading of a vector."""
    return float(np.arctan2(way[1], way[0]))


def turned(angle: float) -> float:
    """An angle within -pi to pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def evaluate(pieces: Array, s: Array) -> tuple[Array, Array]:
    """Points (N, 2) and headings (N,) of a reference line at s (N,)."""
    starts = np.concatenate([[0.0], np.cumsum(pieces[:-1, 3])])
    row = np.clip(np.searchsorted(starts, s, "right") - 1, 0, len(pieces) - 1)
    x, y, heading, _, curvature = pieces[row].T
    along = s - starts[row]
    half = curvature * along / 2
    chord = along * np.sinc(half / np.pi)
    points = np.stack([x + chord * np.cos(heading + half), y + chord * np.sin(heading + half)], 1)
    return points, heading + 2 * half


def _end(piece: Array) -> tuple[Array, float]:
    points, headings = evaluate(piece[None], piece[3:4])
    return points[0], float(headings[0])


def _arc(start: Array, way: Array, end: Array) -> list[float]:
    """The arc from a point in a direction to another point."""
    chord = end - start
    angle = 2 * float(np.arctan2(way[0] * chord[1] - way[1] * chord[0], way @ chord))
    length = float(np.linalg.norm(chord)) / float(np.sinc(angle / 2 / np.pi))
    return [*start, heading_of(way), length, angle / length if length > 0 else 0.0]


def _biarc(start: Array, first: Array, end: Array, last: Array) -> Array:
    """Two arcs (2, 5) between two points with their directions, tangent where they meet."""
    chord, both = end - start, first + last
    denominator = 2 * (1 - float(first @ last))
    along, square = float(chord @ both), float(chord @ chord)
    reach: float
    if denominator > 1e-12:
        # The root without the difference of two nearly equal numbers.
        root = float(np.sqrt(along**2 + denominator * square))
        reach = square / (along + root) if along >= 0 else (root - along) / denominator
    else:
        reach = square / (2 * along) if along > 0 else float(np.sqrt(square)) / 2
    middle = (start + end + reach * (first - last)) / 2
    pieces = np.array([_arc(start, first, middle), _arc(middle, first, end)])
    pieces[1] = _arc(middle, direction(_end(pieces[0])[1]), end)
    return pieces


def apart(one: Array, other: Array) -> float:
    """Largest distance between points of two polylines (N, 2) and the other line, either way."""
    return max(float(beside(one, other).max()), float(beside(other, one).max()))


def beside(points: Array, line: Array) -> Array:
    """(N,) distances of points (N, 2) to a polyline (M, 2)."""
    at: Array = shapely.points(points)
    distances: Array = shapely.distance(at, shapely.LineString(line))
    return distances


def fit(line: Array, ways: Array) -> Array:
    """Pieces along a polyline (N, 2) with directions (N, 2), within `TOLERANCE` of it: each pair
    of arcs goes as far as the tolerance allows, from point to point at least."""
    found, i = [], 0
    while i < len(line) - 1:

        def span(j: int, i: int = i) -> Array:
            return _biarc(line[i], ways[i], line[j], ways[j])

        best, step, j = span(i + 1), 1, i + 1
        while step:  # doubling steps, then halving ones
            next_j = min(j + step, i + _MOST, len(line) - 1)
            if next_j == j:
                break
            pieces = span(next_j)
            at = np.linspace(0, float(pieces[:, 3].sum()), 4 * (next_j - i + 1) + 1)
            if apart(evaluate(pieces, at)[0], line[i : next_j + 1]) <= TOLERANCE:
                best, j, step = pieces, next_j, 2 * step
            else:
                step //= 2
        found.append(best)
        i = j
    return np.concatenate(found)


def merged(pieces: Array) -> Array:
    """Pieces without those of no length; neighbours of one curvature become one piece, and arcs
    that are nearly straight become straight."""
    found: list[Array] = []
    for piece in pieces[pieces[:, 3] > 1e-9]:
        if abs(piece[4]) * piece[3] ** 2 / 8 < _FLAT * 1e-4:
            piece = np.array([*piece[:4], 0.0])
        if found and abs(found[-1][4] - piece[4]) * (found[-1][3] + piece[3]) ** 2 < 1e-7:
            piece = np.array([*found[-1][:3], found[-1][3] + piece[3], found[-1][4]])
            found.pop()
        found.append(piece)
    return np.array(found)


def _reverse(pieces: Array) -> Array:
    rows = []
    for piece in pieces[::-1]:
        point, heading = _end(piece)
        rows.append([*point, turned(heading + np.pi), piece[3], -piece[4]])
    return np.array(rows)


def _to_ray(line: Array, corner: Array, heading: float, reach: float) -> tuple[Array, Array] | None:
    """What replaces the beginning of a polyline so that it begins on the line through `corner`, at
    right angles to `heading`: the rest of the line, and pieces that lead to it; None if the line
    is too short."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    ways = tangents(line)
    angle = turned(heading - heading_of(ways[0]))
    cut = arc = max(_SHORTEST, _OPEN * reach * abs(angle))
    for _ in range(20):
        if cut >= 0.6 * lengths[-1]:
            return None
        point = np.array([np.interp(cut, lengths, axis) for axis in line.T])
        way = np.array([np.interp(cut, lengths, axis) for axis in ways.T])
        way /= np.linalg.norm(way)
        angle = turned(heading - heading_of(way))
        arc = max(_SHORTEST, _OPEN * reach * abs(angle))
        bow = np.array([[0.0, 0.0, heading, arc, -angle / arc]])
        lead = evaluate(bow, np.array([arc]))[0][0]
        normal = direction(heading)
        straight = float((point - lead - corner) @ normal / (way @ normal))
        if -1e-9 <= straight < 0.05:
            break
        cut -= straight - 0.01
    else:
        return None
    middle = point - straight * way
    start = middle - lead
    pieces = np.array(
        [
            [*start, heading, arc, -angle / arc],
            [*middle, heading_of(way), max(straight, 0.0), 0.0],
        ]
    )
    return np.concatenate([point[None], line[lengths > cut + _CLOSEST]]), pieces


def between(line: Array, first: tuple[Array, Array], last: tuple[Array, Array]) -> Array:
    """Pieces along a polyline (N, 2) from one cross section to another.

    Args:
        line: line to follow, such as the centreline of a lane between them.
        first, last: left and right corner (2,) of the first and the last cross section; the
            pieces begin and end on the lines through them, at right angles.
    """
    line = cleaned(line)
    ways = tangents(line)
    ends = []
    for (left, right), way, point in ((first, ways[0], line[0]), (last, ways[-1], line[-1])):
        across = right - left
        width = float(np.linalg.norm(across))
        normal = np.array([-across[1], across[0]]) / max(width, 1e-12)
        # Corners that coincide, or lie the wrong way round, tell no direction.
        heading = heading_of(normal if width > _CLOSEST and normal @ way > 0 else way)
        reach = max(float(np.linalg.norm(corner - point)) for corner in (left, right))
        ends.append(((left + right) / 2, heading, reach + _MARGIN))
    (start, start_heading, start_reach), (end, end_heading, end_reach) = ends
    lead = np.zeros((0, 5))
    tail = np.zeros((0, 5))
    rest, fixed_start, fixed_end = line, True, True
    if abs(turned(start_heading - heading_of(ways[0]))) > _SLANT:
        found = _to_ray(rest, start, start_heading, start_reach)
        if found is None:
            return _single(start, start_heading, end, end_heading)
        rest, lead = found
        fixed_start = False
    if abs(turned(end_heading - heading_of(ways[-1]))) > _SLANT:
        found = _to_ray(rest[::-1], end, turned(end_heading + np.pi), end_reach)
        if found is None:
            return _single(start, start_heading, end, end_heading)
        rest, tail = found[0][::-1], _reverse(found[1])
        fixed_end = False
    rest = rest.copy()
    for fixed, at, corner, heading in (
        (fixed_start, 0, start, start_heading),
        (fixed_end, -1, end, end_heading),
    ):
        if fixed:
            normal = direction(heading)
            rest[at] -= ((rest[at] - corner) @ normal) * normal
    ways = tangents(rest)
    ways[0] = direction(start_heading) if fixed_start else direction(_end(lead[-1])[1])
    ways[-1] = direction(end_heading) if fixed_end else direction(tail[0, 2])
    return merged(np.concatenate([lead, fit(rest, ways), tail]))


def _single(start: Array, heading: float, end: Array, end_heading: float) -> Array:
    """One arc between two cross sections, for lanes that are too short for more."""
    angle, normal = turned(end_heading - heading), direction(end_heading)
    unit = evaluate(np.array([[0.0, 0.0, heading, 1.0, angle]]), np.ones(1))[0][0]
    length = max(float((end - start) @ normal / (unit @ normal)), 1e-3)
    # It ends beside the middle where the sections slant: the difference is shared by both ends.
    across = np.array([-np.sin(heading), np.cos(heading)])
    start = start + across * float((end - start - length * unit) @ across) / 2
    length = max(float((end - start) @ normal / (unit @ normal)), 1e-3)
    return merged(np.array([[*start, heading, length, angle / length]]))


def crossings(pieces: Array, s: Array, boundary: Array) -> Array:
    """(N,) distances to the left of a reference line at s (N,), rising, at which its normals cross
    a polyline (M, 2); at both ends, those of the polyline's ends."""
    points, headings = evaluate(pieces, s)
    normals = np.stack([-np.sin(headings), np.cos(headings)], axis=1)
    first = float((boundary[0] - points[0]) @ normals[0])
    last = float((boundary[-1] - points[-1]) @ normals[-1])
    step, near, found = np.diff(boundary, axis=0), first, np.empty(len(s))
    rows = max(_AT_ONCE // len(step), 1)
    for begin in range(0, len(s), rows):
        block = slice(begin, begin + rows)
        gap, normal = boundary[:-1] - points[block, None], normals[block, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            cross = normal[..., 0] * step[:, 1] - normal[..., 1] * step[:, 0]
            t = (gap[..., 0] * step[:, 1] - gap[..., 1] * step[:, 0]) / cross
            share = (gap[..., 0] * normal[..., 1] - gap[..., 1] * normal[..., 0]) / cross
        hit = (share >= -1e-9) & (share <= 1 + 1e-9) & np.isfinite(t)
        for i, (ts, hits) in enumerate(zip(t, hit, strict=True), begin):
            # A line that bends may be crossed again far away: the nearest to the last one counts.
            near = min(ts[hits].tolist(), key=lambda value: abs(value - near), default=near)
            found[i] = near
    found[0], found[-1] = first, last
    return found


def linear(s: Array, values: Array, tolerance: float, start: str = "s") -> list[dict[str, float]]:
    """Rows a + b ds that follow the values at s within a tolerance. The last one has no slope, for
    readers that look beyond the end: it begins at the last s if need be."""
    rows, i = [], 0
    while i < len(s) - 1:
        low, high, end, slope = -np.inf, np.inf, i + 1, 0.0
        for j in range(i + 1, len(s)):
            ds = s[j] - s[i]
            way = (values[j] - values[i]) / ds
            if low <= way <= high:
                end, slope = j, way
            low = max(low, (values[j] - tolerance - values[i]) / ds)
            high = min(high, (values[j] + tolerance - values[i]) / ds)
            if low > high:
                break
        flat = abs(slope) * (s[-1] - s[0]) < _EVEN
        rows.append((s[i], values[i], 0.0 if flat else slope))
        i = end
    if rows[-1][2]:
        rows.append((s[-1], values[-1], 0.0))
    return [
        {start: float(at), "a": float(a), "b": float(b), "c": 0.0, "d": 0.0} for at, a, b in rows
    ]
