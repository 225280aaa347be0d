"""The four data sets: what they are called, where they come from, and what of them is missing in a folder."""
# Nothing is downloaded. Sizes and licences are those of the data sets' own pages.

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class DataSet:
    """A data set: `folders` are the names that its folder may have below `--data`; `needs` are patterns in it."""

    name: str
    title: str
    folders: tuple[str, ...]
    needs: tuple[tuple[str, str], ...]
    where: str
    size: str
    licence: str

    def folder(self, data: Path) -> Path | None:
        return next((data / name for name in self.folders if (data / name).is_dir()), None)

    def missing(self, data: Path) -> list[str]:
        folder = self.folder(data)
        if folder is None:
            return [f"{self.title}: no folder {' or '.join(str(data / name) for name in self.folders)}"]
        return [
            f"{self.title}: {folder / pattern} is missing: {what}"
            for pattern, what in self.needs
            if next(folder.glob(pattern), None) is None
        ]

    def how_to_get(self) -> str:
        needs = "; ".join(f"{pattern} ({what})" for pattern, what in self.needs)
        return (
            f"{self.title}: from {self.where}; {self.size}; {self.licence}. "
            f"Unpack it as DIR/{self.folders[0]}, so that it holds {needs}."
        )


HOPE = DataSet(
    name="hope", title="HOPE-Video", folders=("hope-dataset", "hope"),
    needs=(
        ("hope_video/scene_*/0000.json", "scenes with NNNN_rgb.jpg, NNNN_depth.png and NNNN.json"),
        ("meshes/eval/*.obj", "the meshes of its objects"),
    ),
    where="github.com/swtyree/hope-dataset, by its setup.py (hope_video and meshes_eval)", size="2.9 GB and 33 MB",
    licence="CC BY-NC-SA 4.0",
)  # fmt: skip
REPLICA_CAD = DataSet(
    name="replica_cad", title="ReplicaCAD", folders=("ReplicaCAD_dataset", "replica_cad_dataset", "replica_cad"),
    needs=(
        ("configs/scenes/apt_*.scene_instance.json", "the apartments"),
        ("configs/objects/*.object_config.json", "which file shows which object"),
        ("objects/*.glb", "the objects"),
        ("stages/*.glb", "walls and floors"),
    ),
    where="huggingface.co/datasets/ai-habitat/ReplicaCAD_dataset (ReplicaCAD Interactive)", size="132 MB",
    licence="CC BY 4.0",
)  # fmt: skip
KIMERA_MULTI = DataSet(
    name="kimera_multi", title="Kimera-Multi", folders=("kimera_multi", "Kimera-Multi-Data"),
    needs=(
        ("**/*_vio.bag", "visual odometry of each robot, <robot>_vio.bag, made by replaying Kimera-VIO"),
        ("**/*_gt_odom.csv", "the ground truth of each robot, <robot>_gt_odom.csv"),
        ("**/*[!o].bag", "the bag of each robot, 10_14_<robot>.bag"),
    ),
    where="github.com/MIT-SPARK/Kimera-Multi-Data, on request", size="its size is not published",
    licence="no licence is stated",
)  # fmt: skip
NUS_CLB = DataSet(
    name="nus_clb", title="NUS-CLB", folders=("nus_clb", "NUS-CLB"),
    needs=(
        ("*/metadata.yaml", "the ROS 2 bag of each run, a folder"),
        ("*.tum", "the true poses of each run, RUN.tum beside RUN/"),
    ),
    where="the paper's authors", size="not published", licence="not published",
)  # fmt: skip
DATA_SETS = (HOPE, REPLICA_CAD, KIMERA_MULTI, NUS_CLB)
