"""Leaderboards: boards, entries, submission, verification and seasons. Ranks are computed in `leaderboards/pages/`."""
