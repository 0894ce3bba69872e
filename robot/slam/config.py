"""The parameters of GraphSlam: one set for every log and every simulated robot."""

import math

from pydantic import Field

from protocol.model import Model


class FrontEndConfig(Model):
    """Scan-to-submap matching and the making of submaps."""

    usable_range_m: float = Field(20.0, gt=1.0, le=100.0, description="longer returns are ignored")
    keyframe_m: float = Field(0.15, gt=0.0, description="motion until a scan is drawn again")
    keyframe_rad: float = Field(math.radians(8.0), gt=0.0)
    journal_m: float = Field(0.3, gt=0.0, description="motion until a keyframe is kept for good")
    journal_rad: float = Field(math.radians(18.0), gt=0.0)
    submap_keyframes: int = Field(30, ge=4, description="keyframes of a full submap")
    submap_m: float = Field(8.0, gt=0.5, description="travel of a full submap")
    doubtful_score: float = Field(
        0.75,
        ge=0.0,
        le=1.0,
        description="a score below this calls for a search of all that the odometry leaves open",
    )
    lost_score: float = Field(
        0.6, ge=0.0, le=1.0, description="and below this of a wide window, if walls are missed too"
    )
    search_m: float = Field(0.6, gt=0.0, description="window of the wide search when lost, ±")
    search_rad: float = Field(math.radians(100.0), gt=0.0)
    drift_m_per_sqrt_m: float = Field(
        0.002, gt=0.0, description="σ of what position drifts against a submap per √metre"
    )
    drift_rad_per_sqrt_m: float = Field(0.0003, gt=0.0)


class ClosureConfig(Model):
    """Which submaps are tried, how widely, and what a match must pass."""

    every_keyframes: int = Field(
        2, ge=1, description="drawn keyframes from one attempt to the next"
    )
    landing_ticks: int = Field(5, ge=1, description="ticks until a search lands")
    radius_m: float = Field(8.0, gt=0.0, description="farthest submap that is tried")
    max_candidates: int = Field(5, ge=1, description="submaps tried in one attempt")
    max_per_pair: int = Field(
        3, ge=1, description="closures between two anchors, after which others are tried"
    )
    max_searches: int = Field(2, ge=0, description="of which by exhaustive search")
    recent: int = Field(2, ge=1, description="the last submaps, which the front end ties anyway")
    near_in_time: int = Field(6, ge=1, description="submaps too young for drift to need a search")
    tied_m: float = Field(
        6.0, ge=0.0, description="travel since the last closure up to which no search is needed"
    )
    window_m: float = Field(0.4, gt=0.0, description="window of a search, ±, at least")
    window_m_per_m: float = Field(0.025, ge=0.0, description="its growth with travel since tied")
    max_window_m: float = Field(5.0, gt=0.0)
    window_rad: float = Field(math.radians(6.0), gt=0.0)
    window_rad_per_m: float = Field(math.radians(0.25), ge=0.0)
    max_window_rad: float = Field(math.radians(45.0), gt=0.0)
    search_points: int = Field(90, ge=10)
    search_floor: float = Field(0.4, ge=0.0, le=1.0, description="scores below end a search")
    min_score: float = Field(0.65, ge=0.0, le=1.0)
    min_overlap: float = Field(0.4, ge=0.0, le=1.0)
    min_hits: float = Field(0.8, ge=0.0, le=1.0)
    max_crossing: float = Field(0.06, ge=0.0, le=1.0)
    max_ambiguity: float = Field(0.9, ge=0.0, le=1.0)


class RevisitConfig(Model):
    """When a place has been seen well enough to be mapped no more."""

    near_m: float = Field(2.0, gt=0.0, description="ways of submaps that come so near count")
    enough_submaps: int = Field(9, ge=1, description="so many make a place well known")
    min_keyframes: int = Field(10, ge=1, description="a submap holds more than these when left")
    settle_score: float = Field(
        0.75, ge=0.0, le=1.0, description="match of a scan in a submap to go on in it"
    )
    leave_score: float = Field(0.65, ge=0.0, le=1.0, description="and below which it is left")
    max_tries: int = Field(4, ge=1, description="submaps tried at once")
    place_m: float = Field(0.5, gt=0.0, description="size of a place that keyframes are counted in")
    place_rad: float = Field(math.radians(90.0), gt=0.0)
    enough_keyframes: int = Field(8, ge=1, description="keyframes kept for good of one place")


class GraphSlamConfig(Model):
    """All of GraphSlam."""

    front_end: FrontEndConfig = FrontEndConfig()
    closures: ClosureConfig = ClosureConfig()
    revisits: RevisitConfig = RevisitConfig()
    explored: RevisitConfig = Field(
        RevisitConfig(
            enough_submaps=1, settle_score=0.67, leave_score=0.6, max_tries=8, enough_keyframes=1
        ),
        description="likewise, once nothing is left to explore in the building",
    )
    optimiser_iterations: int = Field(12, ge=1)
