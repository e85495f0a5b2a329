"""The metrics: functions of a trace that give one value per episode, NaN where a metric is undefined.

`crowdbench list metrics` prints the first line of each docstring, which contains the unit in brackets. A metric with
boolean values is a rate. To add a metric, write its function in the module of its subject, describe it by `describe`,
and name it in `SUBJECTS`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
