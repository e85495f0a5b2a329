"""Leaderboards: boards, entries, submission, verification and seasons. Ranks are those of `leaderboards/site/`."""
