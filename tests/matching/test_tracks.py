"""Tracks: joined over images, one place in each, split at the weakest link."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.matching.scene import joined, star


def tracks_of(links: list[tuple[int, int]], likeness: list[float], pictures: list[int]) -> set[tuple[int, ...]]:
    found = joined(np.array(links, dtype=np.int64).reshape(-1, 2), np.array(likeness), np.array(pictures))
    return {tuple(track) for track in found}


def test_chains_and_triangles_are_one_track() -> None:
    assert tracks_of([(0, 1), (1, 2)], [0.9, 0.8], [0, 1, 2]) == {(0, 1, 2)}
    assert tracks_of([(0, 1), (1, 2), (0, 2)], [0.9, 0.8, 0.7], [0, 1, 2]) == {(0, 1, 2)}
    assert tracks_of([(2, 1), (0, 2)], [0.9, 0.8], [2, 1, 0]) == {(2, 1, 0)}  # by picture
    assert tracks_of([], [], [0, 1]) == set()


def test_conflicts_split_at_the_weakest_link() -> None:
    """Features 0 and 3 are of one picture; the chain between them breaks where it is weakest."""
    pictures = [0, 1, 2, 0]
    chain = [(0, 1), (1, 2), (2, 3)]
    assert tracks_of(chain, [0.9, 0.5, 0.8], pictures) == {(0, 1), (3, 2)}
    assert tracks_of(chain, [0.5, 0.9, 0.8], pictures) == {(3, 1, 2)}
    assert tracks_of(chain, [0.9, 0.8, 0.5], pictures) == {(0, 1, 2)}


@st.composite
def graphs(draw: st.DrawFn) -> tuple[list[tuple[int, int]], list[float], list[int]]:
    count = draw(st.integers(2, 14))
    pictures = draw(st.lists(st.integers(0, 4), min_size=count, max_size=count))
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count) if pictures[i] != pictures[j]]
    links = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=25)) if pairs else []
    likeness = draw(st.permutations(np.linspace(0.5, 1.0, max(len(links), 1)).tolist()))
    return links, likeness[: len(links)], pictures


@settings(deadline=None)
@given(graph=graphs(), seed=st.integers(0, 100))
def test_order_of_links_does_not_matter(graph: tuple[list[tuple[int, int]], list[float], list[int]], seed: int) -> None:
    links, likeness, pictures = graph
    found = tracks_of(links, likeness, pictures)
    order = np.random.default_rng(seed).permutation(len(links))
    turned = [links[k][:: 1 if k % 2 else -1] for k in order]
    assert tracks_of(turned, [likeness[k] for k in order], pictures) == found
    members = [feature for track in found for feature in track]
    assert len(set(members)) == len(members)
    linked = {frozenset(link) for link in links}
    for track in found:
        assert len(track) > 1
        assert len({pictures[f] for f in track}) == len(track)
        reached, edges = {track[0]}, [link for link in linked if link <= set(track)]
        for _ in track:
            for edge in edges:
                reached |= edge if edge & reached else set()
        assert reached == set(track)
    if links:
        best = links[int(np.argmax(likeness))]
        assert any(set(best) <= set(track) for track in found)


def test_stars_begin_at_the_first() -> None:
    track, first, other = star([[4, 7, 1], [2, 3]])
    assert (track.tolist(), first.tolist(), other.tolist()) == ([0, 0, 1], [4, 4, 2], [7, 1, 3])
    assert [part.size for part in star([])] == [0, 0, 0]
