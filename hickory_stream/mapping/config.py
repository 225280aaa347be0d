"""The configuration of the core: one section for each part."""

from dataclasses import dataclass, field

from hickory_stream.base.ranges import Ranged
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.mapping.entities.submaps import SubmapConfig
from hickory_stream.mapping.entities.views import ViewConfig
from hickory_stream.mapping.rules.association import AssociateConfig
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.merging import MergeConfig
from hickory_stream.mapping.rules.shape_requests import RequestConfig
from hickory_stream.mapping.rules.splitting import TrackSplitConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class MappingConfig(Ranged):
    """The configuration of the core, and the voxels that it shares with perception."""

    voxels: Lattice = field(default_factory=Lattice)
    associate: AssociateConfig = field(default_factory=AssociateConfig)
    lifecycle: LifecycleConfig = field(default_factory=LifecycleConfig)
    merge: MergeConfig = field(default_factory=MergeConfig)
    split: TrackSplitConfig = field(default_factory=TrackSplitConfig)
    views: ViewConfig = field(default_factory=ViewConfig)
    requests: RequestConfig = field(default_factory=RequestConfig)
    submaps: SubmapConfig = field(default_factory=SubmapConfig)
