"""One current sensor has one offset: what the cells of a string know of it, put together.

Every cell's filter carries the offset as a state of its own, b_c with variance v_c. Between two exchanges each has
learnt from its own voltage; what it knew before, mean n and variance u (H_SHARED, H_SHARED_VAR), came from the exchange
before and is the same knowledge in all of them, so it is counted once. New is, as information (inverse variance),

    Y_c = 1 / v_c - 1 / u_c,    Y_c z_c = b_c / v_c - n_c / u_c

The errors of the z_c are alike in part: all cells are judged by the same cell file, whose OCV and resistances err the
same way in each. With a correlation rho between any two, N equal cells are worth N / (1 + (N - 1) rho) independent
ones; of unequal cells N is (sum Y)^2 / sum Y^2. So

    1 / v = 1 / u + d sum Y_c,    b = n + v d sum Y_c (z_c - n),    d = 1 / (1 + (N - 1) rho)

and every cell whose own v_c is larger takes (b, v) as a measurement of its bias that leads there: SoC and voltages
follow by their correlation with it. A cell that knows better than all together keeps what it knows. An offset that a
rest told is told to all cells alike, so it moves n and u with b_c and v_c (`bias.fuse_rest`) and is never summed up.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import tri
from bms_ukf.kernel.memory import real
from bms_ukf.kernel.srukf import update


@inline
def exchange(p: Any, s: Any, w: Any, y: Any, string_of: Any, string: int, cells: int, m: Any, alone: Any) -> None:
    """Bring the bias of each cell c < `cells` with string_of[c] == `string` to what all of them know.

    Modifies their records in `s`. `w` and `y` are scratch of one record of the form `alone`, m with one lane.
    """
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    known, known_var = zero, real(p, math.inf)
    for c in range(cells):
        o = c // W * W * m.size + c % W
        if string_of[c] == real(p, string) and s[o + W * k.H_SHARED_VAR] < known_var:
            known, known_var = s[o + W * k.H_SHARED], s[o + W * k.H_SHARED_VAR]
    information, squares, weighted = zero, zero, zero
    for c in range(cells):
        o = c // W * W * m.size + c % W
        before, before_var = s[o + W * k.H_SHARED], s[o + W * k.H_SHARED_VAR]
        variance = own_variance(s, o, m)
        new = one / variance - one / before_var
        if string_of[c] == real(p, string) and new > zero:
            information += new
            squares += new * new
            weighted += s[o + W * (m.x + m.n - 1)] / variance - before / before_var - new * known
    if information > zero:
        worth = information * information / squares
        discount = one / (one + (worth - one) * p[k.P_ALIKE])
        variance = one / (one / known_var + discount * information)
        mean = known + variance * discount * weighted
        for c in range(cells):
            o = c // W * W * m.size + c % W
            if string_of[c] == real(p, string):
                settle(s, o, w, y, mean, variance, m, alone)


@inline
def own_variance(s: Any, o: int, m: Any) -> Any:
    """Of the bias in the record at `o`, A^2; NaN without a belief."""
    total = real(s, 0)
    for j in range(m.n):
        b = s[o + m.lanes * (m.root + tri(m.n - 1, j))]
        total += b * b
    return total


@inline
def settle(s: Any, o: int, w: Any, y: Any, mean: Any, variance: Any, m: Any, alone: Any) -> None:
    """Make the bias of the record at `o` that of all cells, unless it is known better; either is now in common."""
    W, last = m.lanes, m.n - 1
    own, own_var = s[o + W * (m.x + last)], own_variance(s, o, m)
    if own_var > variance:
        for slot in range(m.x, m.cache):
            w[slot] = s[o + W * slot]
        for j in range(m.n):
            y[k.Y_B + j] = w[m.root + tri(last, j)]
        y[k.Y_ALPHA] = variance * own_var / (own_var - variance)
        y[k.Y_INNOVATION] = (mean - own) * (y[k.Y_ALPHA] + own_var) / own_var
        y[k.Y_FUSE], y[k.Y_TRUST] = real(s, k.BY_SIGMA_POINTS), real(s, 1)
        update(w, y, 0, alone)
        total = real(s, 0)
        for slot in range(m.x, m.cache):
            total += abs(w[slot])
        if total - total == real(s, 0):
            for slot in range(m.x, m.cache):
                s[o + W * slot] = w[slot]
            own, own_var = mean, variance
    s[o + W * k.H_SHARED] = own
    s[o + W * k.H_SHARED_VAR] = own_var
