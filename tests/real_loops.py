"""The loop closed on real recordings, once for all tests of a worker: `xdist_group` brings those of one robot together."""

from __future__ import annotations

from functools import cache

from data_folder import data_folder, kr300_without

import rx90b_flex as rf


@cache
def closed_loop(name: str) -> rf.ClosedLoop:
    """On a campaign of the data folder, or skip."""
    return rf.close_loop(data_folder(name) / "campaign.toml")


@cache
def kr300_closed(held_out: str) -> rf.ClosedLoop:
    """On the KR300 with that recording held out; its own campaign holds out C."""
    return closed_loop("kr300_encoders") if held_out == "C" else rf.close_loop(kr300_without(held_out))
