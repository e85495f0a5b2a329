"""Leaderboards of crowdbench: boards, entries, submission, verification, seasons, ranks and pages."""
