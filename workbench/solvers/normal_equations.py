"""Cost and normal equations of a least-squares problem at one place, as a *system* that solvers ask for products.

Dense, or arrowhead: many local blocks that share a few unknowns. Where a problem knows more of its second derivative
than JᵀJ, that stands in the place of JᵀJ.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray


class DenseSystem(NamedTuple):
    """Cost and normal equations of a small dense problem."""

    cost: Float[AnyArray, ""]
    gradient: Float[AnyArray, "n"]
    """Jᵀr."""
    matrix: Float[AnyArray, "n n"]
    """JᵀJ."""

    def diagonal(self) -> Float[AnyArray, "n"]:
        """Diagonal of JᵀJ."""
        return jnp.diagonal(self.matrix)

    def solve(self, extra: Float[AnyArray, "n"], right: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """Solution of (JᵀJ + diag(extra)) s = right."""
        return cho_solve(cho_factor(self.matrix + jnp.diag(extra), lower=True), right)

    def product(self, vector: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """JᵀJ · vector."""
        return self.matrix @ vector

    def restricted(self, moving: Bool[AnyArray, "n"]) -> "DenseSystem":
        """The problem in which only some unknowns move: the others neither feel a force nor pass one on."""
        return DenseSystem(self.cost, self.gradient * moving, self.matrix * (moving[:, None] & moving[None, :]))


class ArrowheadSystem(NamedTuple):
    """Normal equations of `f` local blocks of `m` unknowns that share `s` unknowns; x is [locals…, shared]."""

    cost: Float[AnyArray, ""]
    local_gradient: Float[AnyArray, "f m"]
    shared_gradient: Float[AnyArray, "s"]
    local: Float[AnyArray, "f m m"]
    border: Float[AnyArray, "f m s"]
    shared: Float[AnyArray, "s s"]

    @property
    def gradient(self) -> Float[AnyArray, "n"]:
        """Jᵀr."""
        return jnp.concatenate([self.local_gradient.ravel(), self.shared_gradient])

    def diagonal(self) -> Float[AnyArray, "n"]:
        """Diagonal of JᵀJ."""
        local = jnp.diagonal(self.local, axis1=1, axis2=2)
        return jnp.concatenate([local.ravel(), jnp.diagonal(self.shared)])

    def solve(self, extra: Float[AnyArray, "n"], right: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """Solution of (JᵀJ + diag(extra)) s = right by the Schur complement of the local blocks."""
        count, size = self.local_gradient.shape
        extra_local, right_local = extra[: count * size].reshape(count, size), right[: count * size]
        factor = jnp.linalg.cholesky(self.local + jax.vmap(jnp.diag)(extra_local))
        stacked = jnp.concatenate([self.border, right_local.reshape(count, size, 1)], axis=2)
        solved = jax.vmap(lambda lower, columns: cho_solve((lower, True), columns))(factor, stacked)
        reduced = self.shared + jnp.diag(extra[count * size :])
        reduced = reduced - jnp.einsum("fms,fmt->st", self.border, solved[..., :-1])
        reduced_right = right[count * size :] - jnp.einsum("fms,fm->s", self.border, solved[..., -1])
        shared = cho_solve(cho_factor(reduced, lower=True), reduced_right)
        return jnp.concatenate([(solved[..., -1] - solved[..., :-1] @ shared).ravel(), shared])

    def product(self, vector: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """JᵀJ · vector."""
        count, size = self.local_gradient.shape
        local, shared = vector[: count * size].reshape(count, size), vector[count * size :]
        top = jnp.einsum("fmn,fn->fm", self.local, local) + self.border @ shared
        return jnp.concatenate([top.ravel(), jnp.einsum("fms,fm->s", self.border, local) + self.shared @ shared])

    def restricted(self, moving: Bool[AnyArray, "n"]) -> "ArrowheadSystem":
        """The problem in which only some unknowns move; see `DenseSystem.restricted`."""
        count, size = self.local_gradient.shape
        local, shared = moving[: count * size].reshape(count, size), moving[count * size :]
        return ArrowheadSystem(
            self.cost,
            self.local_gradient * local,
            self.shared_gradient * shared,
            self.local * (local[:, :, None] & local[:, None, :]),
            self.border * (local[:, :, None] & shared),
            self.shared * (shared[:, None] & shared),
        )


System = DenseSystem | ArrowheadSystem


def normal_equations(residual: Float[AnyArray, "m"], jacobian: Float[AnyArray, "m n"]) -> DenseSystem:
    """Cost, Jᵀr and JᵀJ of one residual vector."""
    return DenseSystem(residual @ residual, residual @ jacobian, jacobian.T @ jacobian)
