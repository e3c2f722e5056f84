"""Search and measurement of edges along the rows and columns of an image.

An edge at more than 45 degrees to the rows is searched along a row, any other edge along a column.
The grey levels of pixels are used without interpolation. Each grey level is the mean over the
square of its pixel. If a straight edge separates two uniform grey levels, the sum of the levels
along a row therefore gives the exact column at which the edge crosses the middle of the row.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

MAX_CANDIDATES = 4  # largest number of edge candidates per sample point
# largest number of pixels over which the grey level on one side of an edge is averaged
MAX_LEVEL_PIXELS = 3
# The grey levels are summed over the blurred edge and this length at each end, px. The interval
# therefore contains the edge even if the edge is this far from its expected place.
SEARCH_SLACK = 0.35
MAX_DISTANCE = 1.5  # px; largest distance of a measured edge from its expected place
# Largest deviation of a pixel's grey level from the mean on its side of the edge, as a fraction of
# the edge's contrast.
MAX_UNEVENNESS = 0.35
UNKNOWN_LEVEL = -1.0  # placeholder for an unknown grey level
LEARNING_RATE = 0.2  # weight of the newest image in the running mean of the stored grey levels
NOISE_ROWS = 8  # number of image rows in which the noise is measured


@jit_inline
def _find_crossing(pixel, normal):
    """Return where an edge through `pixel` (2,) with the normal (2,) crosses a row or column.

    Returns:
        0 for a row or 1 for a column; its index, the nearest to the pixel; and the position along
        the middle line of this row or column at which the edge crosses it.
    """
    k = 0 if abs(normal[0]) >= abs(normal[1]) else 1
    line = int(np.rint(pixel[1 - k]))
    return k, line, pixel[k] - (line - pixel[1 - k]) * normal[1 - k] / normal[k]


@jit_inline
def _are_expected(with_normal, against, expected, tolerance):
    """Return whether the grey levels on the two sides of an edge are the `expected` ones (2,)."""
    if expected[0] >= 0.0 and abs(with_normal - expected[0]) > tolerance:
        return False
    return not (expected[1] >= 0.0 and abs(against - expected[1]) > tolerance)


@jit("u1[:,:], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8")
def find_candidates(grey, pixel, normal, expected_levels, reach, min_change, tolerance):
    """Find the edges near each sample point: local maxima of the change of grey level.

    Args:
        grey: (rows, columns) image.
        pixel, normal: (n, 2) `pixels` and `normals` of EdgePoints.
        expected_levels: (n, 2) expected grey levels on the side of the normal and on the other
            side; UNKNOWN_LEVEL accepts any level.
        reach: largest distance from the point along the normal, px.
        min_change: smallest change at an edge, grey levels.
        tolerance: largest difference from an expected level, grey levels.

    Returns:
        (n, MAX_CANDIDATES) distances of the edges along the normal, px, the nearest edge first; NaN
        if there are fewer edges.
    """
    candidates = np.full((len(pixel), MAX_CANDIDATES), np.nan)
    change = np.empty(2 * int(reach * 1.5) + 9)
    for n in range(len(pixel)):
        k, line, edge_position = _find_crossing(pixel[n], normal[n])
        image, along = grey if k == 0 else grey.T, normal[n, k]
        line_count, limit = image.shape
        middle = int(np.rint(edge_position))
        span = int(reach / abs(along)) + 1
        low, high = max(middle - span, 2), min(middle + span, limit - 4)
        if line < 0 or line >= line_count or high - low < 2:
            continue
        # `step` is the smoothed change of the grey level between the pixels i and i + 1.
        for i in range(low, high + 1):
            step = (np.float64(image[line, i + 1]) + image[line, i + 2]
                    - image[line, i] - image[line, i - 1])  # fmt: skip
            change[i - low] = 0.5 * step
        count = 0
        for i in range(low + 1, high):
            c = abs(change[i - low])
            before, behind = abs(change[i - low - 1]), abs(change[i - low + 1])
            if c < min_change or c < before or c <= behind:
                continue
            left = 0.5 * (np.float64(image[line, i - 2]) + image[line, i - 1])
            right = 0.5 * (np.float64(image[line, i + 2]) + image[line, i + 3])
            with_normal, against = (right, left) if along > 0.0 else (left, right)
            if not _are_expected(with_normal, against, expected_levels[n], tolerance):
                continue
            bend = before - 2.0 * c + behind
            shift = 0.5 * (before - behind) / bend if bend < 0.0 else 0.0
            offset = (i + 0.5 + shift - edge_position) * along
            # The candidates of a point are sorted by their distance from the expected edge.
            place = count
            while place > 0 and abs(candidates[n, place - 1]) > abs(offset):
                if place < MAX_CANDIDATES:
                    candidates[n, place] = candidates[n, place - 1]
                place -= 1
            if place < MAX_CANDIDATES:
                candidates[n, place] = offset
                count = min(count + 1, MAX_CANDIDATES)
    return candidates


@jit("u1[:,:], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8")
def measure_edges(grey, pixel, normal, room, expected_levels, min_change, tolerance, noise):
    """Measure the edge at each point from the sum of grey levels along a row or column across it.

    Args:
        grey: (rows, columns) image.
        pixel, normal, room: (n, 2) `pixels`, `normals` and `room` of EdgePoints.
        expected_levels, min_change, tolerance: as in `find_candidates`.
        noise: rms noise of a pixel, grey levels.

    Returns:
        (n, 4) with the columns
            0: distance of the edge along the normal, px;
            1, 2: grey levels on the side of the normal and on the other side;
            3: variance of the distance due to noise, px^2.
        All four are NaN if no edge is measured.
    """
    found = np.full((len(pixel), 4), np.nan)
    values = np.empty(32)
    for n in range(len(pixel)):
        k, line, expected_position = _find_crossing(pixel[n], normal[n])
        image = grey if k == 0 else grey.T
        along, slope = normal[n, k], abs(normal[n, 1 - k] / normal[n, k])
        line_count, limit = image.shape
        if line < 0 or line >= line_count:
            continue
        place, good = expected_position, False
        contrast, level = 0.0, np.zeros(2)
        inside = counted = 0
        slope_of = 0.0
        for _ in range(3):
            # `half` is half of the length over which the edge crosses pixels of this row or column,
            # px. `slope` is the shift of the edge from one row or column to the next, px.
            half = 0.5 * (1.0 + slope) + SEARCH_SLACK
            first, last = int(np.ceil(place - half)), int(np.floor(place + half))
            before = int(first - 1 - (expected_position - room[n, 0] + 0.5 + 0.5 * slope) + 1.0)
            behind = int(expected_position + room[n, 1] - 0.5 - 0.5 * slope - (last + 1) + 1.0)
            before, behind = min(before, MAX_LEVEL_PIXELS), min(behind, MAX_LEVEL_PIXELS)
            good = before >= 1 and behind >= 1 and first - before >= 0 and last + behind < limit
            if not good:
                break
            low, high = first - before, last + behind
            for i in range(low, high + 1):
                values[i - low] = image[line, i]
            count = high - low + 1
            left = right = 0.0
            for i in range(before):
                left += values[i] / before
            for i in range(behind):
                right += values[count - 1 - i] / behind
            contrast = right - left
            good = abs(contrast) >= min_change
            if not good:
                break
            spread = 0.0
            for i in range(before):
                spread = max(spread, abs(values[i] - left))
            for i in range(behind):
                spread = max(spread, abs(values[count - 1 - i] - right))
            slope_of = max(spread - 3.0 * noise, 0.0)
            # the grey level varies next to the edge: extrapolate it from each side to the edge
            if slope_of > 0.0:
                left, right = values[before - 1], values[count - behind]
                if before > 1:
                    left += 0.5 * (left - values[before - 2])
                if behind > 1:
                    right += 0.5 * (right - values[count - behind + 1])
                contrast = right - left
                good = abs(contrast) >= min_change
                if not good:
                    break
            good = spread <= MAX_UNEVENNESS * abs(contrast) + 3.0 * noise
            if not good:
                break
            share = 0.0
            for i in range(before, count - behind):
                share += (right - values[i]) / contrast
            new = first - 0.5 + share
            level[0], level[1] = left, right
            inside, counted = count - before - behind, min(before, behind)
            step, place = abs(new - place), new
            if abs(place - expected_position) > MAX_DISTANCE:
                good = False
                break
            if step < 0.3 * SEARCH_SLACK:
                break
        if not good:
            continue
        with_normal, against = (level[1], level[0]) if along > 0.0 else (level[0], level[1])
        if not _are_expected(with_normal, against, expected_levels[n], tolerance):
            continue
        found[n, 0] = (place - expected_position) * along
        found[n, 1], found[n, 2] = with_normal, against
        around = inside + 0.5 * inside * inside / counted
        found[n, 3] = around * ((noise + slope_of) / contrast) ** 2 * along * along
    return found


@jit("u1[:,:]")
def estimate_noise(grey):
    """Estimate the standard deviation of a pixel's noise, in grey levels.

    It is computed from the median absolute second difference of the grey levels along some rows. It
    is correct if more than half of the pixels of these rows are in smooth regions of the image.
    """
    rows, columns = grey.shape
    counts, total = np.zeros(1021, np.int64), 0
    for v in range(0, rows, max(rows // NOISE_ROWS, 1)):
        for u in range(1, columns - 1):
            bend = 2 * np.int64(grey[v, u]) - np.int64(grey[v, u - 1]) - np.int64(grey[v, u + 1])
            counts[abs(bend)] += 1
            total += 1
    low, high, passed = -1, -1, 0
    for bend in range(len(counts)):  # The median of |bend| is the mean of `low` and `high`.
        passed += counts[bend]
        if low < 0 and 2 * passed >= total:
            low = bend
        if high < 0 and 2 * passed > total:
            high = bend
            break
    return 1.4826 * 0.5 * (low + high) / np.sqrt(6.0) if total else 0.0


@jit("i8[::1], b1[:,::1], f8[:,::1]")
def predict_levels(edge, facing, levels):
    """Return the stored grey levels on both sides of each point's edge.

    Args:
        edge: (n,) `edges` of EdgePoints.
        facing: (n, 2) `are_faces_visible` of EdgePoints.
        levels: (E, 2) stored grey levels on both sides of each of the solid's E edges.

    Returns:
        (n, 2) grey levels; UNKNOWN_LEVEL on a side whose face is not visible.
    """
    found = np.full((len(edge), 2), UNKNOWN_LEVEL)
    for n in range(len(edge)):
        for side in range(2):
            if facing[n, side]:
                found[n, side] = levels[edge[n], side]
    return found


@jit("f8[:,::1], i8[::1], b1[:,::1], f8[:,::1], f8[::1], f8")
def update_levels(levels, edge, facing, values, residuals, inlier_distance):
    """Update the stored grey levels of the edges with the levels measured at their points.

    Args:
        levels: (E, 2) stored grey levels on both sides of each of the solid's E edges. This array
            is changed.
        edge, facing: (n,), (n, 2) `edges` and `are_faces_visible` of EdgePoints.
        values: (n, 4) result of `measure_edges`.
        residuals: (n,) distances of the measured edges from the solid's edges at the fitted pose,
            px.
        inlier_distance: points with residuals of this size or more are ignored, px.
    """
    total, count = np.zeros(levels.shape), np.zeros(levels.shape)
    for n in range(len(edge)):
        for side in range(2):
            if facing[n, side] and abs(residuals[n]) < inlier_distance:
                total[edge[n], side] += values[n, 1 + side]
                count[edge[n], side] += 1.0
    for e in range(len(levels)):
        for side in range(2):
            if count[e, side] > 0.0:
                mean, known = total[e, side] / count[e, side], levels[e, side]
                levels[e, side] = mean if known < 0.0 else known + LEARNING_RATE * (mean - known)
