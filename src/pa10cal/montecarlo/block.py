"""One block of cycles: from drawn normals to lengths of displacements, without allocating."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.montecarlo.displacement import PRODUCT_ROWS, STATE_ROWS, DisplacementPlan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Products:
    """Rows to be multiplied before the matrix: u_x and u_y by sine and by versine."""

    u: Array
    sine: Array
    versine: Array
    by_sine: Array
    by_versine: Array

    def fill(self) -> None:
        np.multiply(self.u, self.sine, out=self.by_sine)
        np.multiply(self.u, self.versine, out=self.by_versine)


@dataclass(frozen=True)
class _Step:
    """One group of joints: `out` is its matrix times `rows`."""

    rows: Array
    out: Array
    products: _Products | None


class DisplacementBlock:
    """Rows for one block of cycles, laid out so that each matrix product reads adjoining rows.

    From the base to the tip: sine and versine of the first joint; then for every further group the
    displacement that comes in from outside, its products, and sine and versine of its joints. At
    the tip nothing comes in. The first group's rows are read together with the second's.

    Attributes:
        normals: (n, cycles), one row a joint: to be filled with standard normals before every
            `displace`, which uses it up.
        error_m: (cycles,) lengths of the displacements, after `displace`.
        squared_m2: (cycles,) their squares.
    """

    def __init__(self, plan: DisplacementPlan, cycles: int) -> None:
        self.normals = np.empty((plan.joints, cycles))
        self.error_m = np.empty(cycles)
        self.squared_m2 = np.empty(cycles)
        self._plan = plan
        self._displacement = np.empty((3, cycles))
        self._turns: list[tuple[Array, Array, Array]] = []
        self._added: list[tuple[Array, Array]] = []
        self._steps: list[_Step] = []
        self._lay_out(cycles)

    def displace(self, position: int) -> None:
        """Turn the drawn normals into displacements at one position of the plan."""
        for inner, outer in self._added:
            np.add(outer, inner, out=outer)
        for normals, sine, versine in self._turns:
            self._plan.turns.fill(normals, sine, versine)
        for step, matrix in zip(self._steps, reversed(self._plan.matrices), strict=True):
            if step.products is not None:
                step.products.fill()
            np.matmul(matrix[position], step.rows, out=step.out)
        squares = self._displacement
        np.multiply(squares, squares, out=squares)
        np.add(squares[0], squares[1], out=self.squared_m2)
        np.add(self.squared_m2, squares[2], out=self.squared_m2)
        np.sqrt(self.squared_m2, out=self.error_m)

    def _lay_out(self, cycles: int) -> None:
        """Give every group its rows, from the base; the steps run from the tip."""
        groups = self._plan.groups
        carried = STATE_ROWS + PRODUCT_ROWS
        incoming = [0, *[carried] * (len(groups) - 2), 0][: len(groups)]
        rows = np.empty((sum(incoming) + 2 * sum(map(len, groups)), cycles))
        out, start, row = self._displacement, 0, 0
        for group, count in zip(groups, incoming, strict=True):
            state = row
            row += count
            for place, joint in enumerate(group):
                self._turns.append((self.normals[joint], rows[row], rows[row + 1]))
                if place:
                    self._added.append((self.normals[joint - 1], self.normals[joint]))
                row += 2
            if group is groups[0] and len(groups) > 1:
                continue
            products = None
            if count:
                by_sine, by_versine = np.split(rows[state + STATE_ROWS : state + carried], 2)
                u = rows[state : state + len(by_sine)]
                products = _Products(u, rows[row - 2], rows[row - 1], by_sine, by_versine)
            self._steps.insert(0, _Step(rows[start:row], out, products))
            out, start = rows[state : state + STATE_ROWS], row
