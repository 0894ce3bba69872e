"""Scans survive as numbers and those as bytes, whatever was foreseen, and nothing else is one."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MalformedMessageError
from robot.team.scan_codec import (
    MAX_CODE,
    STEP_M,
    STEP_SHARE,
    decode_scan,
    encode_scan,
    quantise,
    ranges_of,
    recall,
    store,
)

beam = st.one_of(st.floats(0.0, 100.0), st.just(float("inf")), st.just(float("nan")))
number = st.integers(0, MAX_CODE)
expectation = st.one_of(st.just(float("nan")), st.floats(2.0, 600.0))


@given(st.lists(beam, max_size=300))
def test_a_range_survives_within_half_a_step(values: list[float]) -> None:
    ranges = np.array(values, dtype=np.float64)
    back = ranges_of(quantise(ranges))
    hits = np.isfinite(ranges)
    assert np.array_equal(np.isnan(ranges), np.isnan(back))
    assert np.array_equal(np.isinf(ranges), np.isinf(back))
    # A step grows within itself, by a share of b: half of one is a quarter of that share longer.
    half = 0.5 * (STEP_M + STEP_SHARE * ranges[hits]) * (1.0 + STEP_SHARE / 2.0)
    assert np.all(np.abs(back[hits] - ranges[hits]) <= half)


def test_what_is_too_far_stays_at_the_edge() -> None:
    assert quantise(np.array([1e6]))[0] == MAX_CODE


@given(st.lists(number, max_size=300))
def test_numbers_survive_in_memory(values: list[int]) -> None:
    codes = np.array(values, dtype=np.int64)
    assert np.array_equal(recall(store(codes)), codes)


@given(st.lists(st.tuples(number, expectation), max_size=300))
def test_numbers_survive_whatever_was_foreseen(values: list[tuple[int, float]]) -> None:
    codes = np.array([code for code, _ in values], dtype=np.int64)
    foreseen = np.array([expected for _, expected in values], dtype=np.float64)
    assert np.array_equal(decode_scan(encode_scan(codes, foreseen), foreseen), codes)


@given(st.binary(max_size=100), st.lists(expectation, max_size=60))
def test_no_bytes_break_the_decoder(data: bytes, foreseen: list[float]) -> None:
    with contextlib.suppress(MalformedMessageError):
        codes = decode_scan(data, np.array(foreseen, dtype=np.float64))
        assert len(codes) == 0 or (codes.min() >= 0 and codes.max() <= MAX_CODE)


def test_what_was_foreseen_takes_a_bit_a_beam() -> None:
    angles = np.linspace(-np.pi, np.pi, 257, endpoint=False)
    walls = np.minimum(4.0 / np.abs(np.cos(angles) + 1e-9), 3.0 / np.abs(np.sin(angles) + 1e-9))
    noise = np.random.default_rng(1).normal(0.0, 0.01 + 0.005 * walls)
    codes = quantise(walls + noise)
    exact = np.log1p(STEP_SHARE / STEP_M * walls) / STEP_SHARE + 2.0
    assert len(encode_scan(codes, np.full(257, np.nan))) < 120
    assert len(encode_scan(codes, exact)) < 48


def test_what_follows_a_scan_is_refused() -> None:
    nothing = np.full(50, np.nan)
    scan = encode_scan(quantise(np.linspace(1.0, 5.0, 50)), nothing)
    for more in (b"\x00", b"\x01", bytes(20)):
        with pytest.raises(MalformedMessageError):
            decode_scan(scan + more, nothing)
