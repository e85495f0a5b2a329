"""Check a plug-in against the contract of its kind."""

from crowdbench.check.contract import CheckResult, check_plugin

__all__ = ["CheckResult", "check_plugin"]
