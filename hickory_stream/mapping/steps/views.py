"""The best views of the tracks: proposed by an upper bound of their score, decided once features are computed."""

from dataclasses import replace

from hickory_stream.events import DropView, Effect, FeaturesReady, FrameObserved, KeepView
from hickory_stream.mapping.entities.track import Sighting
from hickory_stream.mapping.entities.views import (
    ViewConfig,
    better,
    covers_better,
    score,
    score_bound,
    sector_of,
    view_of,
)
from hickory_stream.mapping.map_state import MapState, PendingFeatures
from hickory_stream.records import MaskFeature, View


def propose_views(
    state: MapState, event: FrameObserved, sightings: list[Sighting], config: ViewConfig
) -> tuple[dict[int, View], list[Effect]]:
    """Return the views whose score bound beats the track's best view, by observation, and effects that keep views."""
    # A view that is the best of its viewing direction is kept at once (`views.covers_better`).
    candidates: dict[int, View] = {}
    keeps: list[Effect] = []
    for sighting in sightings:
        track_id = state.current_id(sighting.track_id)
        if track_id is None or sighting.is_part:
            continue
        observation, track = sighting.observation, state.tracks[track_id]
        pose = event.world_from_camera
        stamp_ns, index = event.stamp_ns, event.frame_index
        view = view_of(observation, track_id, frame_index=index, stamp_ns=stamp_ns, world_from_camera=pose)
        best = track.best_view
        bound = score_bound(view, config)
        if best is None or best.score is None or bound > best.score:
            candidates[observation.index] = view
        else:
            state.decide("view", track_id, f"frame {event.frame_index}: bound {bound:.3f} <= best {best.score:.3f}")
        sector = sector_of(view, track.box.center)
        coverage = dict(track.coverage)
        if covers_better(view, coverage.get(sector)):
            coverage[sector] = view
            state.tracks[track_id] = replace(track, coverage=tuple(sorted(coverage.items(), key=lambda kv: kv[0])))
            state.keep_view(view.name)
            keeps.append(KeepView(view=view, observation_index=observation.index))
    return candidates, keeps


def judge_views(state: MapState, pending: PendingFeatures, event: FeaturesReady, config: ViewConfig) -> list[Effect]:
    """Make candidates best views where their score is higher; return the effects that keep or drop view pixels."""
    effects: list[Effect] = []
    for feature in sorted(event.features, key=lambda f: f.observation_index):
        view = _judged(state, pending.candidates[feature.observation_index], feature, config)
        if view is not None and view.name not in state.kept_views:
            state.keep_view(view.name)
            effects.append(KeepView(view=view, observation_index=feature.observation_index))
    return effects


def drop_unused_views(state: MapState) -> list[Effect]:
    """Return the effects that drop the pixels of unused views."""
    views = state.derived.views
    gone = views.unused(state.tracks, state.elsewhere, state.absorbed, state.joins, state.kept_views)
    state.kept_views.difference_update(gone)
    return [DropView(name=name) for name in gone]


def _judged(state: MapState, candidate: View, feature: MaskFeature, config: ViewConfig) -> View | None:
    track_id = state.current_id(candidate.object_id)
    if track_id is None:
        return None
    track = state.tracks[track_id]
    value = score(candidate, feature.variance, config)
    view = replace(candidate, object_id=track_id, score=value, variance=feature.variance, feature=feature.pooled)
    coverage = tuple((sector, view if kept.name == view.name else kept) for sector, kept in track.coverage)
    wins = better(track.best_view, view) is view
    before = "no view before" if track.best_view is None else f"best was {track.best_view.score or 0.0:.3f}"
    text = f"sigma^2 {feature.variance:.3f}, area {view.r_area:.4f}, depth {view.r_depth:.2f}), {before}: "
    text = f"frame {view.frame_index}: {config.strategy} {value:.3f} ({text}{'best' if wins else 'kept out'}"
    state.decide("view", track_id, text)
    state.tracks[track_id] = replace(track, coverage=coverage, best_view=view if wins else track.best_view)
    return view if wins else None
