"""What the shared unknowns make of a sight's pose: correction, attitude, and how the camera turns with its parameters.

pose(u) = nominal(u) (+) sum_k B_k(u) c_k (design.md section 3); the c_k are 6-vectors (position in m, rotation in rad).
"""

import math

from mgsgraph.factors.lanes import (
    ATTITUDE,
    BASIS,
    CARRY,
    CHAIN,
    DELTA,
    LANES,
    MATRIX,
    RATE,
    STATE_WIDTH,
    TURNING,
    lane,
    sine_cosine,
)
from mgsgraph.factors.rows import OPK_PAPER


@lane
def pose_components(width):
    """Components of a state that a basis term moves: place and rotation, or the place alone; never focal length or
    range bias, which are single columns.
    """
    return 6 if width >= 6 else 3


@lane
def correct(rows, sight, x, n, w, s, width, rates):
    """DELTA (`width` components) and, if `rates`, RATE: what the unknowns x do to a sight, CARRY lines from its own."""
    for a in range(STATE_WIDTH):
        for l in range(n):
            w[DELTA + a * LANES + l] = 0.0
    if rates:
        for a in range(6):
            for l in range(n):
                w[RATE + a * LANES + l] = 0.0
    terms, entry = rows.sight_terms[sight], rows.sight_entry[sight]
    for t in range(terms):
        basis, column = s + BASIS + t * LANES, rows.entry_column[entry + t]
        rate = basis + terms * LANES
        for a in range(pose_components(width)):
            value = x[column + a]
            if rates:
                for l in range(n):
                    slope = w[rate + l]
                    w[DELTA + a * LANES + l] += (w[basis + l] + w[s + CARRY + l] * slope) * value
                    w[RATE + a * LANES + l] += slope * value
            else:
                for l in range(n):
                    w[DELTA + a * LANES + l] += w[basis + l] * value
    first = s + BASIS + 2 * terms * LANES
    for e in range(rows.sight_shared[sight]):
        value = x[rows.entry_column[entry + terms + e]]
        for a in range(width):
            direction = first + (e * STATE_WIDTH + a) * LANES
            for l in range(n):
                w[DELTA + a * LANES + l] += w[direction + l] * value


@lane
def camera_attitude(n, w, s, predicted):
    """MATRIX and CHAIN for rotation vectors about the camera axes: M = Exp([theta]x)' Exp([carry turning]x)' M0.

    CHAIN is the right Jacobian of SO(3).
    """
    for l in range(n):
        qw, qx, qy, qz = (
            w[s + ATTITUDE + l],
            w[s + ATTITUDE + LANES + l],
            w[s + ATTITUDE + 2 * LANES + l],
            w[s + ATTITUDE + 3 * LANES + l],
        )
        if predicted:
            carry = 0.5 * w[s + CARRY + l]
            h0, h1, h2 = (
                carry * w[s + TURNING + l],
                carry * w[s + TURNING + LANES + l],
                carry * w[s + TURNING + 2 * LANES + l],
            )
            h = math.sqrt(h0 * h0 + h1 * h1 + h2 * h2 + 1e-300)
            sine, rw = sine_cosine(h)
            sinc = -sine / h  # the frame turns, so components turn back
            rx, ry, rz = sinc * h0, sinc * h1, sinc * h2
            qw, qx, qy, qz = (
                rw * qw - rx * qx - ry * qy - rz * qz,
                rw * qx + rx * qw + ry * qz - rz * qy,
                rw * qy - rx * qz + ry * qw + rz * qx,
                rw * qz + rx * qy - ry * qx + rz * qw,
            )
        a0, a1, a2 = w[DELTA + 3 * LANES + l], w[DELTA + 4 * LANES + l], w[DELTA + 5 * LANES + l]
        square = a0 * a0 + a1 * a1 + a2 * a2
        h = 0.5 * math.sqrt(square + 1e-300)
        sine, rw = sine_cosine(h)
        sinc = sine / h
        rx, ry, rz = -0.5 * sinc * a0, -0.5 * sinc * a1, -0.5 * sinc * a2
        qw, qx, qy, qz = (
            rw * qw - rx * qx - ry * qy - rz * qz,
            rw * qx + rx * qw + ry * qz - rz * qy,
            rw * qy - rx * qz + ry * qw + rz * qx,
            rw * qz + rx * qy - ry * qx + rz * qw,
        )
        w[MATRIX + l] = 1.0 - 2.0 * (qy * qy + qz * qz)
        w[MATRIX + LANES + l] = 2.0 * (qx * qy - qw * qz)
        w[MATRIX + 2 * LANES + l] = 2.0 * (qx * qz + qw * qy)
        w[MATRIX + 3 * LANES + l] = 2.0 * (qx * qy + qw * qz)
        w[MATRIX + 4 * LANES + l] = 1.0 - 2.0 * (qx * qx + qz * qz)
        w[MATRIX + 5 * LANES + l] = 2.0 * (qy * qz - qw * qx)
        w[MATRIX + 6 * LANES + l] = 2.0 * (qx * qz - qw * qy)
        w[MATRIX + 7 * LANES + l] = 2.0 * (qy * qz + qw * qx)
        w[MATRIX + 8 * LANES + l] = 1.0 - 2.0 * (qx * qx + qy * qy)
        half = 0.5 * sinc * sinc  # (1 - cos) / square
        series = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square * (1.0 / 362880.0)))
        third = series if square < 1e-3 else (1.0 - sinc * rw) / (square + 1e-300)
        w[CHAIN + l] = 1.0 + third * (a0 * a0 - square)
        w[CHAIN + LANES + l] = third * a0 * a1 + half * a2
        w[CHAIN + 2 * LANES + l] = third * a0 * a2 - half * a1
        w[CHAIN + 3 * LANES + l] = third * a1 * a0 - half * a2
        w[CHAIN + 4 * LANES + l] = 1.0 + third * (a1 * a1 - square)
        w[CHAIN + 5 * LANES + l] = third * a1 * a2 + half * a0
        w[CHAIN + 6 * LANES + l] = third * a2 * a0 + half * a1
        w[CHAIN + 7 * LANES + l] = third * a2 * a1 - half * a0
        w[CHAIN + 8 * LANES + l] = 1.0 + third * (a2 * a2 - square)


@lane
def angle_attitude(n, w, s, convention):
    """MATRIX and CHAIN for corrections that add to omega, phi, kappa: M = R3 R2 R1 (the peer), or its transpose.

    CHAIN's columns are the camera axes about which each angle turns it: d(M d) = [M d]x T da.
    """
    for l in range(n):
        carry = w[s + CARRY + l]
        so, co = sine_cosine(w[s + ATTITUDE + l] + carry * w[s + TURNING + l] + w[DELTA + 3 * LANES + l])
        sp, cp = sine_cosine(
            w[s + ATTITUDE + LANES + l] + carry * w[s + TURNING + LANES + l] + w[DELTA + 4 * LANES + l]
        )
        sk, ck = sine_cosine(
            w[s + ATTITUDE + 2 * LANES + l] + carry * w[s + TURNING + 2 * LANES + l] + w[DELTA + 5 * LANES + l]
        )
        w[MATRIX + l] = cp * ck
        w[MATRIX + 4 * LANES + l] = co * ck - so * sp * sk
        w[MATRIX + 8 * LANES + l] = co * cp
        r01, r02, r12 = co * sk + so * sp * ck, so * sk - co * sp * ck, so * ck + co * sp * sk
        r10, r20, r21 = -cp * sk, sp, -so * cp
        w[MATRIX + LANES + l], w[MATRIX + 2 * LANES + l], w[MATRIX + 5 * LANES + l] = r01, r02, r12
        w[MATRIX + 3 * LANES + l], w[MATRIX + 6 * LANES + l], w[MATRIX + 7 * LANES + l] = r10, r20, r21
        w[CHAIN + l], w[CHAIN + LANES + l], w[CHAIN + 2 * LANES + l] = cp * ck, sk, 0.0
        w[CHAIN + 3 * LANES + l], w[CHAIN + 4 * LANES + l], w[CHAIN + 5 * LANES + l] = -cp * sk, ck, 0.0
        w[CHAIN + 6 * LANES + l], w[CHAIN + 7 * LANES + l], w[CHAIN + 8 * LANES + l] = sp, 0.0, 1.0
    for l in range(n if convention == OPK_PAPER else 0):  # M = R1' R2' R3': camera to body is R3 R2 R1
        r01, r02, r12 = w[MATRIX + LANES + l], w[MATRIX + 2 * LANES + l], w[MATRIX + 5 * LANES + l]
        r10, r20, r21 = w[MATRIX + 3 * LANES + l], w[MATRIX + 6 * LANES + l], w[MATRIX + 7 * LANES + l]
        w[MATRIX + LANES + l], w[MATRIX + 2 * LANES + l], w[MATRIX + 5 * LANES + l] = r10, r20, r21
        w[MATRIX + 3 * LANES + l], w[MATRIX + 6 * LANES + l], w[MATRIX + 7 * LANES + l] = r01, r02, r12
        so, co = sine_cosine(w[s + ATTITUDE + l] + w[s + CARRY + l] * w[s + TURNING + l] + w[DELTA + 3 * LANES + l])
        w[CHAIN + l], w[CHAIN + LANES + l], w[CHAIN + 2 * LANES + l] = -1.0, 0.0, -r20
        w[CHAIN + 3 * LANES + l], w[CHAIN + 4 * LANES + l], w[CHAIN + 5 * LANES + l] = 0.0, -co, -r21
        w[CHAIN + 6 * LANES + l], w[CHAIN + 7 * LANES + l], w[CHAIN + 8 * LANES + l] = (
            0.0,
            -so,
            -w[MATRIX + 8 * LANES + l],
        )
