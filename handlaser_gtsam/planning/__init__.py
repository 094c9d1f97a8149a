"""Where to go next: stations that determine a calibration, chosen before they are measured."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .blind import blind_motion as blind_motion
    from .bounds import Bounds as Bounds
    from .bounds import Placement as Placement
    from .bounds import Plate as Plate
    from .goal import Forecast as Forecast
    from .goal import Goal as Goal
    from .robot import Robot as Robot
    from .route import Plan as Plan
    from .workspace import Workspace as Workspace
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
