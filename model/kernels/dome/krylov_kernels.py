"""The linear system of a round of Newton on a dome's contact, by preconditioned BiCGStab.

Each node's own law is solved with the other nodes' forces held, so that only the coupling between
nodes is left: with its force f = Φ(u*) for the displacement u* by the others, B = dΦ/du* and A₀
the compliance without each node's own 3 × 3,

    δf − B·(A₀·δf − Jᵀ·δξ) = r,        M·δξ + J·(Q·δf − n·κ·r̂·A·δf) = q

are the changes of the forces and of the object's pose. M is the inertia and drag of the object over
the step, and Q and κ make the true force of the linear one, see `touch`. However stiff the object
is, B is at most 1/A_kk.

Where two fingertips hold one object, A has a square for each and nothing between them, and ξ has a
seventh entry: the way on which both close.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]


class System(NamedTuple):
    """Arrays of the linear system of m nodes, with room for more; x axes of the object, 6 or 7.

    Attributes
    ----------
    block: A, compliance among the nodes of the first fingertip [m/N], (3c, 3c)
    second: that among the nodes of the second, which come after them; (0, 0) where there is none
    own: A_kk, (c, 3, 3)
    answer: B [N/m], (c, 3, 3)
    true: Q, (c, 3, 3)
    bend: n·κ·r̂ᵀ [N/m], (c, 3, 3)
    arm: J, wrench on the object of a force on each of its nodes, (x, 3c)
    inertia: M [N/m, N·m], (x, x)
    pose_inverse: inverse of the pose's equations with the nodes eliminated, (x, x)
    pose_share: J·(Q − n·κ·r̂ᵀ·A_kk), (x, 3c)
    vectors: of the iteration, (9, 3c + x)
    gathered: how many nodes both blocks are of, how many of them are the first fingertip's, and
        from [2] on which, (c + 2,)
    share: of the compliance that is in each block, (2,)
    """

    block: Single
    second: Single
    own: Single
    answer: Single
    true: Single
    bend: Single
    arm: Single
    inertia: Single
    pose_inverse: Single
    pose_share: Single
    vectors: Single
    gathered: Index
    share: Single


def new_system(nodes: int, second: int = 0) -> System:
    """System with room for so many nodes of a fingertip, and of a second one."""

    def zeros(*shape: int) -> Single:
        return np.zeros(shape, np.float32)

    both, axes = nodes + second, 7 if second else 6
    size = 3 * both
    return System(
        block=zeros(3 * nodes, 3 * nodes),
        second=zeros(3 * second, 3 * second),
        own=zeros(both, 3, 3),
        answer=zeros(both, 3, 3),
        true=zeros(both, 3, 3),
        bend=zeros(both, 3, 3),
        arm=zeros(axes, size),
        inertia=zeros(axes, axes),
        pose_inverse=zeros(axes, axes),
        pose_share=zeros(axes, size),
        vectors=zeros(9, size + axes),
        gathered=np.full(both + 2, -1, np.int64),
        share=zeros(2),
    )


@njit()
def product(matrix: Single, x: Array | Single, y: Array | Single, size: int) -> None:
    """Product y = matrix·x for a symmetric matrix, four columns at once, as precise as x and y."""
    for i in range(size):
        y[i] = 0.0
    j = 0
    while j + 4 <= size:
        a, b, c, d = matrix[j], matrix[j + 1], matrix[j + 2], matrix[j + 3]
        xa, xb, xc, xd = x[j], x[j + 1], x[j + 2], x[j + 3]
        for i in range(size):
            y[i] += (a[i] * xa + b[i] * xb) + (c[i] * xc + d[i] * xd)
        j += 4
    while j < size:
        a = matrix[j]
        for i in range(size):
            y[i] += a[i] * x[j]
        j += 1


@njit()
def product_of(
    matrix: Single, columns: Index, count: int, x: Array | Single, y: Array | Single, size: int
) -> None:
    """Product y = matrix·x as `product`, with the first `count` of `columns` of the matrix only."""
    for i in range(size):
        y[i] = 0.0
    k = 0
    while k + 4 <= count:
        ja, jb, jc, jd = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        a, b, c, d = matrix[ja], matrix[jb], matrix[jc], matrix[jd]
        xa, xb, xc, xd = x[ja], x[jb], x[jc], x[jd]
        for i in range(size):
            y[i] += (a[i] * xa + b[i] * xb) + (c[i] * xc + d[i] * xd)
        k += 4
    while k < count:
        a = matrix[columns[k]]
        for i in range(size):
            y[i] += a[i] * x[columns[k]]
        k += 1


@njit()
def _dot(x: Single, y: Single, size: int) -> float:
    """Inner product in eight lanes, single precision."""
    s = np.zeros(8, np.float32)
    whole = size - size % 8
    for k in range(0, whole, 8):
        for lane in range(8):
            s[lane] += x[k + lane] * y[k + lane]
    for k in range(whole, size):
        s[k - whole] += x[k] * y[k]
    return float((s[0] + s[4]) + (s[1] + s[5]) + ((s[2] + s[6]) + (s[3] + s[7])))


@njit()
def invert(matrix: Array, out: Array, size: int) -> bool:
    """Inverse of the leading square of a matrix by elimination with pivots; False if singular."""
    work = np.zeros((size, 2 * size))
    for i in range(size):
        for j in range(size):
            work[i, j] = matrix[i, j]
        work[i, size + i] = 1.0
    for i in range(size):
        best = i
        for k in range(i + 1, size):
            if abs(work[k, i]) > abs(work[best, i]):
                best = k
        if work[best, i] == 0.0 or not np.isfinite(work[best, i]):
            return False
        if best != i:
            for j in range(2 * size):
                work[i, j], work[best, j] = work[best, j], work[i, j]
        pivot = 1.0 / work[i, i]
        for j in range(2 * size):
            work[i, j] *= pivot
        for k in range(size):
            if k != i:
                share = work[k, i]
                if share != 0.0:
                    for j in range(2 * size):
                        work[k, j] -= share * work[i, j]
    for i in range(size):
        for j in range(size):
            out[i, j] = work[i, size + j]
    return True


@njit(forceinline=True)
def invert_three(m: Array, out: Array) -> bool:
    """Inverse of a 3 × 3 matrix by cofactors; False if it is singular."""
    out[0, 0] = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    out[0, 1] = m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]
    out[0, 2] = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    out[1, 0] = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    out[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]
    out[1, 2] = m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]
    out[2, 0] = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    out[2, 1] = m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]
    out[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    determinant = m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0]
    if determinant == 0.0 or not np.isfinite(determinant):
        return False
    for a in range(3):
        for b in range(3):
            out[a, b] /= determinant
    return True


@njit()
def prepare(system: System, nodes: int, inertia: Array, free: Array) -> bool:
    """Fill in the preconditioner of the pose; False where it has no solution.

    Parameters
    ----------
    inertia: M, (x, x)
    free: whether each axis of the pose is free, (x,); `system.arm` is zero along the others
    """
    axes = len(free)
    pose = inertia.copy()
    part = np.empty((3, 3))
    for k in range(nodes):
        for a in range(3):
            for b in range(3):
                total = float(system.true[k, a, b])
                for d in range(3):
                    total -= system.bend[k, a, d] * system.own[k, d, b]
                part[a, b] = total
        for c in range(axes):
            for b in range(3):
                total = 0.0
                for d in range(3):
                    total += system.arm[c, 3 * k + d] * part[d, b]
                system.pose_share[c, 3 * k + b] = total
        for c in range(axes):
            for d in range(axes):
                for a in range(3):
                    for b in range(3):
                        pose[c, d] -= (
                            system.pose_share[c, 3 * k + a]
                            * system.answer[k, a, b]
                            * system.arm[d, 3 * k + b]
                        )
    for c in range(axes):
        for d in range(axes):
            system.inertia[c, d] = inertia[c, d] if free[c] and free[d] else 0.0
            if not (free[c] and free[d]):
                pose[c, d] = 1.0 if c == d else 0.0
    inverse = np.empty((axes, axes))
    if not invert(pose, inverse, axes):
        return False
    for c in range(axes):
        for d in range(axes):
            system.pose_inverse[c, d] = inverse[c, d] if free[c] and free[d] else 0.0
    return True


@njit(forceinline=True)
def _answer(system: System, w: Single, y: Single, size: int) -> None:
    """Take B·w from y for every node."""
    for k in range(size // 3):
        w0, w1, w2 = w[3 * k], w[3 * k + 1], w[3 * k + 2]
        b = system.answer[k]
        y[3 * k] -= b[0, 0] * w0 + b[0, 1] * w1 + b[0, 2] * w2
        y[3 * k + 1] -= b[1, 0] * w0 + b[1, 1] * w1 + b[1, 2] * w2
        y[3 * k + 2] -= b[2, 0] * w0 + b[2, 1] * w1 + b[2, 2] * w2


@njit()
def _precondition(system: System, y: Single, size: int) -> None:
    """Solve for the pose as if no node moved another, in place, (size + x,)."""
    axes = len(system.arm)
    w = system.vectors[8]
    for k in range(size):
        w[k] = 0.0
    right = np.empty(axes, np.float32)
    for c in range(axes):
        total = np.float32(0.0)
        row = system.pose_share[c]
        for k in range(size):
            total += row[k] * y[k]
        right[c] = y[size + c] - total
    for c in range(axes):
        step = np.float32(0.0)
        for d in range(axes):
            step += system.pose_inverse[c, d] * right[d]
        y[size + c] = step
        row = system.arm[c]
        for k in range(size):
            w[k] += row[k] * step
    _answer(system, w, y, size)


@njit()
def _apply(system: System, x: Single, y: Single, size: int, moves: bool) -> None:
    """The system times x, preconditioned, into y; both (size + x,)."""
    axes, first = len(system.arm), 3 * system.gathered[1]
    w = system.vectors[8]
    product(system.block, x, w, first)
    if first < size:
        product(system.second, x[first:], w[first:], size - first)
    for k in range(size):
        y[k] = x[k]
    if moves:
        for c in range(axes):
            y[size + c] = 0.0
            for d in range(axes):
                y[size + c] += system.inertia[c, d] * x[size + d]
    for k in range(size // 3):
        if moves:
            q, n = system.true[k], system.bend[k]
            for a in range(3):
                force = np.float32(0.0)
                for d in range(3):
                    force += q[a, d] * x[3 * k + d] - n[a, d] * w[3 * k + d]
                for c in range(axes):
                    y[size + c] += system.arm[c, 3 * k + a] * force
        own = system.own[k]
        x0, x1, x2 = x[3 * k], x[3 * k + 1], x[3 * k + 2]
        w[3 * k] -= own[0, 0] * x0 + own[0, 1] * x1 + own[0, 2] * x2
        w[3 * k + 1] -= own[1, 0] * x0 + own[1, 1] * x1 + own[1, 2] * x2
        w[3 * k + 2] -= own[2, 0] * x0 + own[2, 1] * x1 + own[2, 2] * x2
    if moves:
        for c in range(axes):
            step, row = x[size + c], system.arm[c]
            for k in range(size):
                w[k] -= row[k] * step
    _answer(system, w, y, size)
    if moves:
        _precondition(system, y, size)


@njit()
def solve(
    system: System, nodes: int, right: Array, moves: bool, tolerance: float, out: Array
) -> int:
    """Solution of the system to a relative residual; returns the number of products with A.

    Parameters
    ----------
    right: r of the nodes, then q of the pose, (3·nodes + x,)
    moves: whether the object's pose is free on any axis
    out: δg, then δξ, (3·nodes + x,)
    """
    size = 3 * nodes
    whole = size + len(system.arm) if moves else size
    x, r, r0, p, v, t = (
        system.vectors[0], system.vectors[1], system.vectors[2], system.vectors[3],
        system.vectors[4], system.vectors[5],
    )  # fmt: skip
    for k in range(whole):
        r[k] = right[k]
        x[k], p[k], v[k] = 0.0, 0.0, 0.0
    if moves:
        _precondition(system, r, size)
    for k in range(whole):
        r0[k] = r[k]
    start = _dot(r, r, whole)
    goal = tolerance * tolerance * start
    rho, alpha, omega = 1.0, 1.0, 1.0
    products = 0
    if start == 0.0:
        out[:] = 0.0
        return products
    for turn in range(60):
        rho_now = _dot(r0, r, whole)
        if abs(rho_now) < 1e-30 * start:
            break
        beta = np.float32(rho_now / rho * alpha / omega) if turn else np.float32(0.0)
        rho, step = rho_now, np.float32(omega)
        for k in range(whole):
            p[k] = r[k] + beta * (p[k] - step * v[k])
        _apply(system, p, v, size, moves)
        products += 1
        against = _dot(r0, v, whole)
        if against == 0.0:
            break
        alpha = rho / against
        step = np.float32(alpha)
        for k in range(whole):
            x[k] += step * p[k]
            r[k] -= step * v[k]
        if _dot(r, r, whole) < goal:
            break
        _apply(system, r, t, size, moves)
        products += 1
        along = _dot(t, t, whole)
        if along == 0.0:
            break
        omega = _dot(t, r, whole) / along
        step = np.float32(omega)
        for k in range(whole):
            x[k] += step * r[k]
            r[k] -= step * t[k]
        if omega == 0.0 or _dot(r, r, whole) < goal:
            break
    for k in range(whole):
        out[k] = x[k]
    return products
