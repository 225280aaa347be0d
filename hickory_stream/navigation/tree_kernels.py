"""Kernels of the planners: edges over free cells, turns on the spot, growth of trees, shortening of paths.

Positions are in cells, from the low corner of the grid. A state is posture * headings + heading; -1 is not set. An edge
is valid if all cells that it touches are free, a turn if every heading that it passes is free.
"""

import numpy as np

from hickory_stream.base.compiled import kernel

# Tolerance in cells: a segment along the edge of a cell touches both neighbours.
_HAIR = 1e-9
NO_STATE = -1
_NO_WAY = -2


@kernel
def way_is_free(blocked, x0, y0, x1, y1):
    """Return whether all cells that a segment touches are free; cells outside the grid are not."""
    rows, columns = blocked.shape
    if y1 < y0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    first, last = int(np.floor(y0 - _HAIR)), int(np.floor(y1 + _HAIR))
    if first < 0 or last >= rows:
        return False
    slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
    for j in range(first, last + 1):
        xa = x0 if y0 >= j else x0 + slope * (j - y0)
        xb = x1 if y1 <= j + 1 else x0 + slope * (j + 1 - y0)
        left, right = int(np.floor(min(xa, xb) - _HAIR)), int(np.floor(max(xa, xb) + _HAIR))
        if left < 0 or right >= columns:
            return False
        for i in range(left, right + 1):
            if blocked[j, i]:
                return False
    return True


@kernel
def turn_is_free(blocked, x, y, before, after):
    """Return whether the robot can change its state at a position, by a turn in either posture and direction."""
    headings = blocked.shape[1]
    if before < 0 or after < 0 or headings == 1:
        return True
    j, i = int(np.floor(y)), int(np.floor(x))
    a, b = before % headings, after % headings
    for posture in (before // headings, after // headings):
        for way in (1, -1):
            k = a
            while not blocked[posture, k, j, i]:
                if k == b:
                    return True
                k = (k + way) % headings
                if k == a:
                    break
    return False


@kernel
def state_after(blocked, x0, y0, before, x1, y1, is_backward):
    """Return the state in which the robot gets from one position to the next, -2 if there is none."""
    # Postures in their order, forwards before backwards. `is_backward`: driven from the second position to the first,
    # as in a tree that grows from the goal.
    postures, headings = blocked.shape[:2]
    heading = 0
    if headings > 1:
        angle = np.arctan2(y0 - y1, x0 - x1) if is_backward else np.arctan2(y1 - y0, x1 - x0)
        heading = int(np.round(angle * headings / (2 * np.pi))) % headings
    for posture in range(postures):
        for reverse in range(2 if headings > 1 and headings % 2 == 0 else 1):
            k = (heading + reverse * headings // 2) % headings
            state = posture * headings + k
            if way_is_free(blocked[posture, k], x0, y0, x1, y1) and turn_is_free(blocked, x0, y0, before, state):
                return state
    return _NO_WAY


@kernel
def _nearest(points, count, x, y):
    best, nearest = 0, np.inf
    for n in range(count):
        dx, dy = points[n, 0] - x, points[n, 1] - y
        squared = dx * dx + dy * dy
        if squared < nearest:
            best, nearest = n, squared
    return best


@kernel
def _branch(points, parents, n):
    length, at = 0, n
    while at >= 0:
        length += 1
        at = parents[at]
    out = np.empty((length, 2))
    at = n
    for i in range(length - 1, -1, -1):
        out[i] = points[at]
        at = parents[at]
    return out


@kernel
def grow_rrt(blocked, start, goal, start_state, goal_state, samples, toss, step, bias):
    """Return the path that the RRT of the paper finds (empty if none), and the number of iterations."""
    count = 1
    most = len(samples) + 2
    points, parents, states = np.empty((most, 2)), np.empty(most, np.int64), np.empty(most, np.int64)
    points[0], parents[0], states[0] = start, -1, start_state
    for n in range(len(samples)):
        x, y = samples[n, 0], samples[n, 1]
        if toss[n] < bias:
            x, y = goal[0], goal[1]
        near = _nearest(points, count, x, y)
        dx, dy = x - points[near, 0], y - points[near, 1]
        length = np.sqrt(dx * dx + dy * dy)
        if length > step:
            x, y = points[near, 0] + dx * step / length, points[near, 1] + dy * step / length
        if length == 0.0:
            continue
        state = state_after(blocked, points[near, 0], points[near, 1], states[near], x, y, False)
        if state < 0:
            continue
        points[count, 0], points[count, 1] = x, y
        parents[count], states[count] = near, state
        count += 1
        gx, gy = goal[0] - x, goal[1] - y
        if gx * gx + gy * gy <= step * step:
            last = state
            if gx != 0.0 or gy != 0.0:
                last = state_after(blocked, x, y, state, goal[0], goal[1], False)
            if last >= 0 and turn_is_free(blocked, goal[0], goal[1], last, goal_state):
                if gx != 0.0 or gy != 0.0:
                    points[count], parents[count] = goal, count - 1
                    count += 1
                return _branch(points, parents, count - 1), n + 1
    return np.empty((0, 2)), len(samples)


@kernel
def grow_connect(blocked, start, goal, start_state, goal_state, samples, step):
    """Return the path of RRT-Connect (Kuffner and LaValle, 2000; empty if none), and the number of iterations."""
    most = 4 * len(samples) + 64
    points, parents, states = np.empty((2, most, 2)), np.empty((2, most), np.int64), np.empty((2, most), np.int64)
    counts = np.array([1, 1])
    points[0, 0], points[1, 0] = start, goal
    parents[:, 0], states[0, 0], states[1, 0] = -1, start_state, goal_state
    # Before any sample, the straight segment is tried.
    state = state_after(blocked, start[0], start[1], start_state, goal[0], goal[1], False)
    if state >= 0 and turn_is_free(blocked, goal[0], goal[1], state, goal_state):
        direct = np.empty((2, 2))
        direct[0], direct[1] = start, goal
        return direct, 0
    for n in range(len(samples)):
        one = n % 2
        two = 1 - one
        x, y = samples[n, 0], samples[n, 1]
        near = _nearest(points[one], counts[one], x, y)
        dx, dy = x - points[one, near, 0], y - points[one, near, 1]
        length = np.sqrt(dx * dx + dy * dy)
        if length == 0.0 or max(counts[0], counts[1]) + 4 > most:
            continue
        added = _link(blocked, points[one], parents[one], states[one], counts[one], near, x, y, one == 1)
        if added == 0 and length > step:
            x, y = points[one, near, 0] + dx * step / length, points[one, near, 1] + dy * step / length
            added = _link(blocked, points[one], parents[one], states[one], counts[one], near, x, y, one == 1)
        if added == 0:
            continue
        counts[one] += added
        node = counts[one] - 1
        # The other tree is extended towards the new node, as far as possible.
        at = _nearest(points[two], counts[two], x, y)
        while counts[two] + 4 <= most:
            dx, dy = x - points[two, at, 0], y - points[two, at, 1]
            length = np.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                added = _link(blocked, points[two], parents[two], states[two], counts[two], at, x, y, two == 1)
                if added > 0:
                    counts[two] += added
                    at = counts[two] - 1
                    length = 0.0
            if length == 0.0:
                if turn_is_free(blocked, x, y, states[one, node], states[two, at]):
                    first = _branch(points[one], parents[one], node)
                    second = _branch(points[two], parents[two], at)[:-1]
                    if one == 1:
                        first, second = _branch(points[two], parents[two], at), first[:-1]
                    return np.concatenate((first, second[::-1])), n + 1
                break
            if length <= step:
                break
            bx, by = points[two, at, 0] + dx * step / length, points[two, at, 1] + dy * step / length
            reached = state_after(blocked, points[two, at, 0], points[two, at, 1], states[two, at], bx, by, two == 1)
            if reached < 0:
                break
            after = counts[two]
            points[two, after, 0], points[two, after, 1] = bx, by
            parents[two, after], states[two, after] = at, reached
            counts[two] += 1
            at = after
    return np.empty((0, 2)), len(samples)


@kernel
def _link(blocked, points, parents, states, count, near, x, y, is_backward):
    # Straight, or, where the heading collides at the position (a doorway), over the nearest point of a line along a
    # free heading through the position: the robot turns there and follows that line. Returns the number of nodes.
    ax, ay = points[near, 0], points[near, 1]
    state = state_after(blocked, ax, ay, states[near], x, y, is_backward)
    if state >= 0:
        points[count, 0], points[count, 1], parents[count], states[count] = x, y, near, state
        return 1
    headings = blocked.shape[1]
    if headings == 1:
        return 0
    j, i = int(np.floor(y)), int(np.floor(x))
    if j < 0 or i < 0 or j >= blocked.shape[2] or i >= blocked.shape[3]:
        return 0
    towards = int(np.round(np.arctan2(y - ay, x - ax) * headings / (2 * np.pi)))
    for offset in range(1, headings // 4 + 1):
        for side in (-1, 1):
            k = (towards + side * offset) % headings
            is_fitting = False
            for posture in range(blocked.shape[0]):
                is_fitting |= not blocked[posture, k, j, i]
            if not is_fitting:
                continue
            angle = 2 * np.pi * k / headings
            along = (x - ax) * np.cos(angle) + (y - ay) * np.sin(angle)
            if along < 1.0:
                continue
            rx, ry = x - along * np.cos(angle), y - along * np.sin(angle)
            first = state_after(blocked, ax, ay, states[near], rx, ry, is_backward)
            if first < 0:
                continue
            second = state_after(blocked, rx, ry, first, x, y, is_backward)
            if second < 0:
                continue
            points[count, 0], points[count, 1], parents[count], states[count] = rx, ry, near, first
            points[count + 1, 0], points[count + 1, 1] = x, y
            parents[count + 1], states[count + 1] = count, second
            return 2
    return 0


@kernel
def _cost_to(points, parents, states, costs, headings, n):
    total = 0.0
    while parents[n] >= 0:
        before = parents[n]
        dx, dy = points[n, 0] - points[before, 0], points[n, 1] - points[before, 1]
        total += np.sqrt(dx * dx + dy * dy) * costs[states[n] // headings]
        n = before
    return total


@kernel
def grow_star(blocked, start, goal, start_state, goal_state, samples, costs, step, first_cost):
    """Return the best path of an informed RRT* (Gammell et al., 2014; empty if none), and the number of iterations."""
    # Only samples that can improve on the best path, at first of `first_cost`, are used. A node with successors is
    # rewired only if the robot need not turn.
    headings = blocked.shape[1]
    most = len(samples) + 1
    points, parents = np.empty((most, 2)), np.full(most, -1, np.int64)
    states, successors = np.full(most, NO_STATE, np.int64), np.zeros(most, np.int64)
    points[0], states[0] = start, start_state
    count, best_node, best_cost = 1, -1, first_cost
    near = np.empty(most, np.int64)
    for n in range(len(samples)):
        x, y = samples[n, 0], samples[n, 1]
        ahead = np.sqrt((goal[0] - x) ** 2 + (goal[1] - y) ** 2)
        if np.sqrt((start[0] - x) ** 2 + (start[1] - y) ** 2) + ahead >= best_cost:
            continue
        nearest = _nearest(points, count, x, y)
        dx, dy = x - points[nearest, 0], y - points[nearest, 1]
        length = np.sqrt(dx * dx + dy * dy)
        if length == 0.0:
            continue
        if length > step:
            x, y = points[nearest, 0] + dx * step / length, points[nearest, 1] + dy * step / length
        reach = min(step, 3.0 * step * np.sqrt(np.log(count + 1.0) / (count + 1.0))) + 1e-9
        around = 0
        for k in range(count):
            if (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 <= reach * reach or k == nearest:
                near[around] = k
                around += 1
        parent, state, cost = -1, NO_STATE, np.inf
        for m in range(around):
            k = near[m]
            way = np.sqrt((points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2)
            before = _cost_to(points, parents, states, costs, headings, k)
            if before + way < cost:
                found = state_after(blocked, points[k, 0], points[k, 1], states[k], x, y, False)
                if found >= 0 and before + way * costs[found // headings] < cost:
                    parent, state, cost = k, found, before + way * costs[found // headings]
        if parent < 0:
            continue
        node = count
        points[node, 0], points[node, 1] = x, y
        parents[node], states[node] = parent, state
        successors[parent] += 1
        count += 1
        for m in range(around):
            k = near[m]
            if k == parent or parents[k] < 0 or (headings > 1 and successors[k] > 0):
                continue
            way = np.sqrt((points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2)
            before = _cost_to(points, parents, states, costs, headings, k)
            if cost + way < before:
                found = state_after(blocked, x, y, state, points[k, 0], points[k, 1], False)
                if found >= 0 and cost + way * costs[found // headings] < before:
                    successors[parents[k]] -= 1
                    parents[k], states[k] = node, found
                    successors[node] += 1
        way = np.sqrt((goal[0] - x) ** 2 + (goal[1] - y) ** 2)
        if cost + way < best_cost and way <= 4.0 * step:
            found = state_after(blocked, x, y, state, goal[0], goal[1], False)
            if found >= 0 and turn_is_free(blocked, goal[0], goal[1], found, goal_state):
                total = cost + way * costs[found // headings]
                if total < best_cost:
                    best_node, best_cost = node, total
    if best_node < 0:
        return np.empty((0, 2)), len(samples)
    branch = _branch(points, parents, best_node)
    out = np.empty((len(branch) + 1, 2))
    out[:-1] = branch
    out[-1] = goal
    return out, len(samples)


@kernel
def states_along(blocked, path, start_state, goal_state):
    """Return the state of each segment, and whether the whole path can be driven."""
    states = np.empty(len(path) - 1, np.int64)
    before = start_state
    for i in range(len(path) - 1):
        before = state_after(blocked, path[i, 0], path[i, 1], before, path[i + 1, 0], path[i + 1, 1], False)
        if before < 0:
            return states, False
        states[i] = before
    return states, turn_is_free(blocked, path[-1, 0], path[-1, 1], before, goal_state)


@kernel
def cost_along(path, states, costs, headings):
    """Return the cost of a path, in cells."""
    total = 0.0
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        total += np.sqrt(dx * dx + dy * dy) * costs[states[i] // headings]
    return total


@kernel
def thinned(blocked, path, start_state):
    """Return the positions of a path that remain if each is followed by the farthest one in a free straight line."""
    # A shortcut may not need a later posture than its first segment: the robot does not lower itself to shorten.
    headings = blocked.shape[1]
    out = np.empty_like(path)
    out[0] = path[0]
    count, at, state = 1, 0, start_state
    while at < len(path) - 1:
        to, after = at + 1, _NO_WAY
        for k in range(at + 1, len(path)):
            if path[k, 0] == path[at, 0] and path[k, 1] == path[at, 1]:
                continue
            found = state_after(blocked, path[at, 0], path[at, 1], state, path[k, 0], path[k, 1], False)
            if after >= 0 and (found < 0 or found // headings > after // headings):
                break
            to, after = k, found
        out[count] = path[to]
        count += 1
        at, state = to, after
    return out[:count].copy()


@kernel
def shortened(blocked, path, start_state, goal_state, costs, spacing, most):
    """Return a path of least cost over at most `most` positions of the given one, which are at most `spacing` apart."""
    # Dynamic programming over the shortcuts between all pairs; optimal among them for a robot that need not turn.
    length = 0.0
    for i in range(len(path) - 1):
        length += np.sqrt((path[i + 1, 0] - path[i, 0]) ** 2 + (path[i + 1, 1] - path[i, 1]) ** 2)
    spacing = max(spacing, length / max(most - len(path), 1))
    dense = np.empty((most + 2 * len(path) + 2, 2))
    count = 0
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        pieces = max(int(np.ceil(np.sqrt(dx * dx + dy * dy) / spacing)), 1)
        for k in range(pieces):
            dense[count, 0], dense[count, 1] = path[i, 0] + dx * k / pieces, path[i, 1] + dy * k / pieces
            count += 1
    dense[count] = path[-1]
    count += 1
    headings = blocked.shape[1]
    best, before = np.full(count, np.inf), np.full(count, -1, np.int64)
    states = np.full(count, NO_STATE, np.int64)
    best[0], states[0] = 0.0, start_state
    for j in range(1, count):
        for i in range(j):
            way = np.sqrt((dense[j, 0] - dense[i, 0]) ** 2 + (dense[j, 1] - dense[i, 1]) ** 2)
            if best[i] + way >= best[j]:
                continue
            if way == 0.0:
                best[j], before[j], states[j] = best[i], i, states[i]
                continue
            state = state_after(blocked, dense[i, 0], dense[i, 1], states[i], dense[j, 0], dense[j, 1], False)
            if state < 0 or best[i] + way * costs[state // headings] >= best[j]:
                continue
            if j == count - 1 and not turn_is_free(blocked, dense[j, 0], dense[j, 1], state, goal_state):
                continue
            best[j], before[j], states[j] = best[i] + way * costs[state // headings], i, state
    if before[count - 1] < 0:
        return path.copy()
    return _branch(dense, before, count - 1)


@kernel
def cut_corners(blocked, path, start_state, goal_state, costs, rounds, most):
    """Return a path with its corners cut as far as cells are free (string pulling)."""
    headings = blocked.shape[1]
    for _ in range(rounds):
        gained = 0.0
        i = 1
        while i < len(path) - 1 and len(path) < most:
            states, is_free = states_along(blocked, path, start_state, goal_state)
            if not is_free:
                return path
            old = cost_along(path, states, costs, headings)
            share = 1.0
            for _ in range(5):
                trial = np.empty((len(path) + 1, 2))
                trial[:i] = path[:i]
                trial[i] = path[i] + share * (path[i - 1] - path[i])
                trial[i + 1] = path[i] + share * (path[i + 1] - path[i])
                trial[i + 2 :] = path[i + 1 :]
                # Both sides are cut whole, so that the corner vanishes.
                if share == 1.0:
                    trial = np.concatenate((path[:i], path[i + 1 :]))
                states, is_free = states_along(blocked, trial, start_state, goal_state)
                if is_free:
                    new = cost_along(trial, states, costs, headings)
                    if new < old - 1e-3:
                        path = trial
                        gained += old - new
                        break
                share *= 0.5
            i += 1
        path = shortened(blocked, path, start_state, goal_state, costs, 1e9, most)
        if gained < 1e-2:
            break
    return path
