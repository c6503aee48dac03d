"""Images as a graph that links join: its groups, what it can't do without, and the tree that holds it together best."""

import numpy as np

from mgsgraph.geometry.records import Index, Mask


def _neighbours(images: int, pairs: Index) -> list[list[tuple[int, int]]]:
    """For each image the images that a pair joins to it, with the pair's row."""
    found: list[list[tuple[int, int]]] = [[] for _ in range(images)]
    for row, (i, j) in enumerate(pairs.tolist()):
        found[i].append((j, row))
        found[j].append((i, row))
    return found


def groups(images: int, pairs: Index) -> list[tuple[int, ...]]:
    """Images that pairs (p, 2) join, largest group first, then by their first image."""
    beside, left, groups = _neighbours(images, pairs), set(range(images)), []
    for start in range(images):
        if start not in left:
            continue
        left.discard(start)
        group, front = [start], [start]
        while front:
            for other, _ in beside[front.pop()]:
                if other in left:
                    left.discard(other)
                    group.append(other)
                    front.append(other)
        groups.append(tuple(sorted(group)))
    return sorted(groups, key=len, reverse=True)


def bridges_and_cuts(images: int, pairs: Index, linked: Mask) -> tuple[Mask, Index]:
    """Pairs (p,) and images whose loss parts an island: the depth-first search of Hopcroft & Tarjan (1973)."""
    rows = np.flatnonzero(linked)
    beside = _neighbours(images, pairs[rows])
    depth, low, children = [-1] * images, [0] * images, [0] * images
    bridges, cuts = np.zeros(len(pairs), dtype=bool), set[int]()
    for root in range(images):
        if depth[root] >= 0:
            continue
        depth[root] = 0
        path = [(root, -1, iter(beside[root]))]
        while path:
            image, through, others = path[-1]
            for other, row in others:
                if depth[other] < 0:
                    depth[other] = low[other] = len(path)
                    children[image] += 1
                    path.append((other, row, iter(beside[other])))
                    break
                if row != through:
                    low[image] = min(low[image], depth[other])
            else:
                path.pop()
                if path:
                    parent = path[-1][0]
                    low[parent] = min(low[parent], low[image])
                    bridges[rows[through]] = low[image] > depth[parent]
                    if low[image] >= depth[parent] and parent != root:
                        cuts.add(parent)
        if children[root] > 1:
            cuts.add(root)
    return bridges, np.array(sorted(cuts), dtype=np.int64)


def spine(images: int, pairs: Index, points: Index) -> Index:
    """Rows of the maximum spanning tree of each island by common points, weakest first (Kruskal)."""
    leader = list(range(images))

    def find(image: int) -> int:
        while leader[image] != image:
            leader[image] = image = leader[leader[image]]
        return image

    rows = []
    for row in np.argsort(-points, kind="stable").tolist():
        if points[row] == 0:
            break
        one, other = (find(image) for image in pairs[row].tolist())
        if one != other:
            leader[one] = other
            rows.append(row)
    return np.array(rows[::-1], dtype=np.int64)
