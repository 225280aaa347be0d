"""The shortest route over grid cells (A*): it finds the side on which to pass obstacles, which random trees may miss.

It is no shortest path, but shortening it nearly always yields one. It is used for robots that need not turn.
"""

import heapq

import numpy as np

from hickory_stream.base.compiled import kernel

_STEPS = np.array([[0, 1], [1, 0], [0, -1], [-1, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]])


@kernel
def route_over_cells(costs, row, column, goal_row, goal_column):
    """Return (N, 2) the cell centres x, y, in cells, of a cheapest route by A*; empty if there is no route."""
    # `costs` (rows, columns) are at least 1 per cell's length, infinite where blocked. Cells have eight neighbours; a
    # diagonal step needs both cells beside it to be free.
    rows, columns = costs.shape
    best, before = np.full(rows * columns, np.inf), np.full(rows * columns, -1, np.int64)
    done = np.zeros(rows * columns, np.bool_)
    start, goal = row * columns + column, goal_row * columns + goal_column
    best[start] = 0.0
    queue = [(0.0, start)]
    while len(queue) > 0:
        _, at = heapq.heappop(queue)
        if at == goal:
            break
        if done[at]:
            continue
        done[at] = True
        j, i = at // columns, at % columns
        for n in range(8):
            b, a = j + _STEPS[n, 0], i + _STEPS[n, 1]
            if b < 0 or a < 0 or b >= rows or a >= columns or not np.isfinite(costs[b, a]):
                continue
            length = 1.0
            if n >= 4:
                if not (np.isfinite(costs[b, i]) and np.isfinite(costs[j, a])):
                    continue
                length = np.sqrt(2.0)
            cost = best[at] + length * max(costs[j, i], costs[b, a])
            to = b * columns + a
            if cost < best[to]:
                best[to], before[to] = cost, at
                dx, dy = abs(a - goal_column), abs(b - goal_row)
                ahead = max(dx, dy) + (np.sqrt(2.0) - 1.0) * min(dx, dy)
                heapq.heappush(queue, (cost + ahead, to))
    if not np.isfinite(best[goal]):
        return np.empty((0, 2))
    count, at = 0, goal
    while at >= 0:
        count += 1
        at = before[at]
    out = np.empty((count, 2))
    at = goal
    for k in range(count - 1, -1, -1):
        out[k, 0], out[k, 1] = at % columns + 0.5, at // columns + 0.5
        at = before[at]
    return out
