from .checks import CheckResult as CheckResult
from .checks import check_plugin as check_plugin
