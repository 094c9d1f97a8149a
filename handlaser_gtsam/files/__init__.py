"""Every file format that goes in or out."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .calibration_reading import CalibrationFile as CalibrationFile
    from .calibration_reading import SurveyFile as SurveyFile
    from .logs.format import LogReport as LogReport
    from .rig_toml import Rig as Rig
    from .sensor_tables import SensorTable as SensorTable
    from .sensor_tables import SurveyTables as SurveyTables
    from .study_toml import read_runs as read_runs
    from .study_toml import write_runs as write_runs
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
