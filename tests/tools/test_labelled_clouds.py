import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from tools.evaluation.masks.labelled_clouds import clouds_in, load_cloud

WIDTH, HEIGHT = 64, 48
HEADER = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS label x y z rgba\nSIZE 4 4 4 4 4\nTYPE U F F F U\nCOUNT 1 1 1 1 1\n"
    f"WIDTH {WIDTH}\nHEIGHT {HEIGHT}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {WIDTH * HEIGHT}\nDATA "
)


def cloud():
    """A table that a camera looks down on at 45 degrees, with one label for each half."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    focal = 52.5
    ray_y = (v - (HEIGHT - 1) / 2) / focal
    z = 1.0 / (ray_y + 1.0)  # on the plane y + z = 1
    rows = np.zeros(WIDTH * HEIGHT, dtype=[("label", "<u4"), *((n, "<f4") for n in "xyz"), ("rgba", "<u4")])
    rows["z"] = z.ravel()
    rows["x"], rows["y"] = ((u - (WIDTH - 1) / 2) / focal * z).ravel(), (ray_y * z).ravel()
    rows["label"], rows["rgba"] = np.where(u < 32, 31, 1).ravel(), 0xFF102030
    rows["x"][5] = rows["y"][5] = rows["z"][5] = np.nan
    return rows


def lzf_literals(data):
    return b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))


def write_packed(path, columns, packed):
    sizes = np.array([len(packed), len(columns)], dtype="<u4").tobytes()
    path.write_bytes(HEADER.encode() + b"binary_compressed\n" + sizes + packed)
    return path


def columns_of(rows):
    return b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in rows.dtype.names)


def write(path, form):
    rows = cloud()
    if form == "binary":
        path.write_bytes(HEADER.encode() + b"binary\n" + rows.tobytes())
        return path
    return write_packed(path, columns_of(rows), lzf_literals(columns_of(rows)))


@pytest.mark.parametrize("form", ["binary", "binary_compressed"])
def test_a_cloud_is_a_frame_with_up_from_its_largest_plane(tmp_path, form):
    loaded = load_cloud(write(tmp_path / "a.pcd", form))
    assert loaded.frame.rgb[3, 3].tolist() == [0x10, 0x20, 0x30]
    assert np.isnan(loaded.frame.depth_m[0, 5])
    assert np.isfinite(loaded.frame.depth_m).sum() == WIDTH * HEIGHT - 1
    # A further piece is of the thing that it is a piece of.
    assert sorted(np.unique(loaded.truth)) == [1, 30]
    assert loaded.frame.world_from_camera[2, :3] == pytest.approx([0.0, -np.sqrt(0.5), -np.sqrt(0.5)], abs=1e-3)


def test_references_to_what_was_written_before_are_followed(tmp_path):
    columns = columns_of(cloud())
    # The last column repeats four bytes: one literal, then references of 264 bytes four back.
    start = 4 * 4 * WIDTH * HEIGHT
    packed = lzf_literals(columns[: start + 4])
    left = len(columns) - start - 4
    while left:
        length = min(left, 264)
        if left - length in (1, 2):  # too short for a reference of its own
            length -= 2
        packed += bytes([7 << 5, length - 9, 3]) if length > 8 else bytes([(length - 2) << 5, 3])
        left -= length
    path = write_packed(tmp_path / "a.pcd", columns, packed)
    assert (load_cloud(path).frame.rgb == [0x10, 0x20, 0x30]).all()


@pytest.mark.parametrize("cut", [10, 120, len(HEADER) + 30, -50])
def test_a_damaged_file_or_a_folder_without_clouds_is_refused(tmp_path, cut):
    with pytest.raises(RecordingError, match="labelled clouds"):
        clouds_in(tmp_path)
    path = write(tmp_path / "a.pcd", "binary_compressed")
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(RecordingError, match=r"a\.pcd is no organised PCD"):
        load_cloud(path)


def test_the_real_clouds_have_labelled_things_on_a_level_table(mosd):
    for path in clouds_in(mosd):
        things = np.unique(load_cloud(path).truth)
        assert set(things[things > 1]) <= {20, 30, 40}
        assert len(things[things > 1]) >= 2
