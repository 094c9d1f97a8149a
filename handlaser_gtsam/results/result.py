"""What is asked of any calibration first: its status, its verdict, what there is to say, its graph."""

from abc import abstractmethod
from typing import TYPE_CHECKING

from ..data.value import Value
from ..errors import CalibrationWarning
from .limits import Limits
from .verdict import Verdict

if TYPE_CHECKING:  # they take long to import, and few need them
    import gtsam

    from ..factors.of_blocks import BlockGraph
    from ..solvers.graph import CalibrationGraph
    from .description.description import Description


class Result(Value):
    """Base of the calibrations of beams before planes and of surveys.

    Notes
    -----
    A result can be pickled, copied and compared, which GTSAM graphs with Python factors cannot. So it
    does not keep its graph: `problem`, and `graph` and `values` after it, build it again.
    """

    __slots__ = ()
    if TYPE_CHECKING:  # fields of the subclasses

        @property
        def status(self) -> str:
            """`converged` where there is a calibration."""

        @property
        def message(self) -> str:
            """The same in words."""

        @property
        def warnings(self) -> tuple[CalibrationWarning, ...]:
            """Signs that the result should not be believed, the gravest first."""

    @abstractmethod
    def judged(self, limits: Limits | None = None, reading: float | None = None) -> Verdict:
        """Return the verdict by what a user demands."""

    @abstractmethod
    def described(self, verdict: Verdict) -> "Description":
        """Return what there is to say of it under a verdict, for the views of this package."""

    @abstractmethod
    def problem(self) -> "CalibrationGraph | BlockGraph":
        """Return its factor graph, with the keys of everything."""

    @property
    def success(self) -> bool:
        """Whether the solver converged on a solution that the readings determine."""
        return self.status == "converged"

    @property
    def verdict(self) -> Verdict:
        """Whether to use it, what it is good for, what may hide, and what would improve it most.

        Without limits of a user; `judged` takes them.
        """
        return self.judged()

    @property
    def usable(self) -> bool:
        """Whether it can be used, by its verdict."""
        return self.verdict.usable

    @property
    def graph(self) -> "gtsam.NonlinearFactorGraph":
        """The factor graph that was solved, built again every time; see `problem`."""
        return self.problem().graph

    @property
    def values(self) -> "gtsam.Values":
        """The solution as GTSAM values, for `graph`; see `problem`."""
        return self.problem().values

    def summary(self, limits: Limits | None = None, reading: float | None = None) -> str:
        """Return what `handlaser calibrate` prints, the verdict first, in 100 columns.

        But for the next best stations, which `hl.plan` chooses.

        Parameters
        ----------
        limits : Limits, optional
            What its user demands; the verdict says whether it holds.
        reading : float, optional
            Working distance at which laser spots are judged [m], of beams before planes; the median
            reading where not given.
        """
        return "\n".join(self.described(self.judged(limits, reading)).screen())

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict, and a row a beam or sensor."""
        return self.described(self.verdict).notebook_html()
