"""Compiled walks over a pose graph: what hangs together, and where edges put it."""

import math

import numpy as np

from protocol.kernel import kernel
from protocol.pose_kernels import apply, compose, wrap


@kernel
def label_components(node_count, edge_nodes):
    """A label for each node, equal for nodes that edges connect (union-find)."""
    parent = np.arange(node_count)
    for k in range(edge_nodes.shape[0]):
        a = edge_nodes[k, 0]
        b = edge_nodes[k, 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    for n in range(node_count):
        a = n
        while parent[a] != a:
            a = parent[a]
        parent[n] = a
    return parent


@kernel
def first_fault(node_count, edge_nodes, fixed):
    """What is wrong with a graph: (1, edge) that names a node that is not there, (2, edge) that
    ties a node to itself, (3, node) that is tied to no fixed one; (0, 0) if nothing is."""
    for k in range(edge_nodes.shape[0]):
        for end in range(2):
            if not 0 <= edge_nodes[k, end] < node_count:
                return 1, k
    for k in range(edge_nodes.shape[0]):
        if edge_nodes[k, 0] == edge_nodes[k, 1]:
            return 2, k
    labels = label_components(node_count, edge_nodes)
    held = np.zeros(node_count, dtype=np.bool_)
    for n in range(node_count):
        if fixed[n]:
            held[labels[n]] = True
    for n in range(node_count):
        if not held[labels[n]]:
            return 3, n
    return 0, 0


@kernel
def chain(edge_nodes, measurements, first, nodes):
    """Place nodes (m×3, NaN where no chain leads) by edges, from node 0 at `first`.

    Odometry first: a node follows from the one before it where an edge says so. What does not stand
    then follows by any edge from a node that does, in the order of the edges.
    """
    count = nodes.shape[0]
    edges = edge_nodes.shape[0]
    nodes[:, :] = np.nan
    starts = np.zeros(count + 1, dtype=np.int64)
    for k in range(edges):
        for end in range(2):
            starts[edge_nodes[k, end] + 1] += 1
    for n in range(count):
        starts[n + 1] += starts[n]
    ways = np.empty(2 * edges, dtype=np.int64)
    following = starts[:-1].copy()
    for k in range(edges):
        for end in range(2):
            n = edge_nodes[k, end]
            ways[following[n]] = k
            following[n] += 1
    # Edges that wait, as (edge, end that stands); those of the odometry on a pile that goes first.
    queue = np.empty((2 * edges, 2), dtype=np.int64)
    pile = np.empty((2 * edges, 2), dtype=np.int64)
    head = 0
    tail = 0
    height = 0
    n = 0
    nodes[0] = first
    while True:
        for p in range(starts[n + 1] - 1, starts[n] - 1, -1):
            k = ways[p]
            end = 0 if edge_nodes[k, 0] == n else 1
            other = edge_nodes[k, 1 - end]
            if not math.isnan(nodes[other, 0]):
                continue
            if other == n + 1:
                pile[height, 0] = k
                pile[height, 1] = end
                height += 1
            else:
                queue[tail, 0] = k
                queue[tail, 1] = end
                tail += 1
        found = False
        while not found and (height > 0 or head < tail):
            if height > 0:
                height -= 1
                k = pile[height, 0]
                end = pile[height, 1]
            else:
                k = queue[head, 0]
                end = queue[head, 1]
                head += 1
            n = edge_nodes[k, 1 - end]
            found = math.isnan(nodes[n, 0])
        if not found:
            return
        i = edge_nodes[k, end]
        t = measurements[k]
        if end == 0:
            compose(nodes[i], t, nodes[n])
        else:
            nodes[n, 0] = nodes[i, 0]
            nodes[n, 1] = nodes[i, 1]
            nodes[n, 2] = nodes[i, 2] - t[2]
            nodes[n, 0], nodes[n, 1] = apply(nodes[n], -t[0], -t[1])
        nodes[n, 2] = wrap(nodes[n, 2])
