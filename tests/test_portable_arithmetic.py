"""Nothing between pixels and a map's digest computes with what rounds differently on another processor.

What is allowed is named with its reason; what is not is done by `hickory_stream.geometry.portable`.
"""

import ast
from pathlib import Path
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
# Networks round as onnxruntime does: a run with them says so (`engine/shape_jobs/processor.py`).
REGISTRATION = ("keyframe_registration", "registration_config", "surface_alignment", "surface_image")
BOXES = ("geometry", "perception", "mapping", "shapes", "graph", "journal", "map_folder", "engine")
PATHS = (
    *sorted(
        file
        for box in BOXES
        for file in (ROOT / "hickory_stream" / box).rglob("*.py")
        # Networks and generators run outside of it; what looks back decides nothing.
        if not {"models", "generators", "history"} & set(file.parts)
    ),
    *(ROOT / "hickory_stream" / "poses" / f"{name}.py" for name in REGISTRATION),
    *sorted(file for file in (ROOT / "players").rglob("*.py") if "live" not in file.parts),
)
# Not on the way from pixels to a digest.
EXEMPT = {
    "hickory_stream/geometry/display.py": "where a viewer looks first, and its colours of features",
    "players/doctor/depth_bias.py": "what `doctor` says of the depth camera",
    "players/doctor/depth_color_alignment.py": "what `doctor` says of a calibration",
    "players/doctor/depth_noise.py": "what `doctor` says of the depth camera",
    "players/doctor/motion_agreement.py": "what `doctor` says of the poses",
    "players/doctor/motion_mends.py": "what `doctor` says of the poses",
    "players/poses/pose_gaps.py": "what is said of frames without a pose",
}
# Choose their code by the processor, or leave the order of their terms to a library that does.
NUMPY = frozenset(
    "dot vdot inner matmul tensordot einsum cov corrcoef polyfit "
    "exp exp2 expm1 log log2 log10 log1p logaddexp logaddexp2 sin cos tan arcsin arccos arctan arctan2 "
    "sinh cosh tanh arcsinh arccosh arctanh power float_power cbrt hypot argpartition".split()
)
MATH = frozenset(
    "exp exp2 expm1 log log2 log10 log1p pow sin cos tan asin acos atan atan2 sinh cosh tanh cbrt hypot dist "
    "gamma lgamma erf erfc sumprod fma".split()
)
# One loop in C without choice of code; the bench's `digest_variants` runs them under each variant.
SCIPY = {
    "ndimage": {
        "label", "find_objects", "distance_transform_edt", "binary_fill_holes", "binary_dilation", "uniform_filter",
        "correlate1d",
    },
    "sparse": {"coo_array"},
    "sparse.csgraph": {"connected_components"},
    "spatial": {"cKDTree"},
    "special": {"beta"},
}  # fmt: skip
# Integers, copies and comparisons, or single precision without products that could be fused: as measured, the same
# with and without AVX2, FMA and IPP. Filters of floating-point images are not (`perception/descriptor.py`).
CV2 = frozenset(
    "resize dilate erode morphologyEx blur connectedComponentsWithStats distanceTransformWithLabels copyMakeBorder "
    "copyTo cvtColor imdecode imencode remap initUndistortRectifyMap fisheye".split()
)


def forbidden_in(source):
    """Yield "line: what" for everything in a module that rounds as its processor does."""
    tree = ast.parse(source)
    kernels = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and _is_kernel(node)]
    in_kernels = {id(inner) for kernel in kernels for inner in ast.walk(kernel)}
    for node in ast.walk(tree):
        found = _why_not(node, in_kernel=id(node) in in_kernels)
        if found is not None:
            yield f"{getattr(node, 'lineno', 0)}: {found}"


def _is_kernel(function):
    return any("kernel" in ast.unparse(decorator) for decorator in function.decorator_list)


def _why_not(node, *, in_kernel):
    match node:
        case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
            return "@: portable.matmul"
        case ast.BinOp(left=left, op=ast.Pow(), right=right) if not (_is_count(left) and _is_count(right)):
            # Numba turns a small whole power into products; Python and NumPy ask the C library.
            return None if in_kernel and _is_count(right) else "**: products, np.square or portable.power"
        case ast.ImportFrom(module=str(module)) if module.startswith("scipy"):
            return _outside(module, {alias.name for alias in node.names})
        case ast.Call(func=ast.Name() | ast.Attribute() as function, keywords=keywords):
            # Of what is called on a result only the method's name counts.
            name = ast.unparse(function)
            name = name if name.replace(".", "").isidentifier() else f"_.{name.rpartition('.')[2]}"
            return _why_no_call(name, {str(keyword.arg) for keyword in keywords}, in_kernel)
        case _:
            return None


def _is_count(node):
    return isinstance(node, ast.Constant) and isinstance(node.value, int)


def _outside(module, names):
    part = module.removeprefix("scipy").removeprefix(".")
    known = set(SCIPY) if not part else SCIPY.get(part, set())
    return f"from {module} import {', '.join(sorted(names - known))}" if names - known else None


def _why_no_call(name, keywords, in_kernel):
    first, _, rest = name.partition(".")
    if name.endswith(("njit", "kernel")) and keywords & {"fastmath", "parallel"}:
        return f"{name}: the order of terms is the compiler's"
    if name.endswith(".dot") and first not in ("np", "portable"):
        return f"{name}: portable.dot"
    if name.endswith("argsort") and not in_kernel and "kind" not in keywords:
        return f"{name}: kind='stable', or ties are in the processor's order"
    if name == "np.linalg.norm":
        # Of a whole vector it is BLAS's; along an axis it is NumPy's sum of squares.
        return None if "axis" in keywords and not in_kernel else f"{name}: portable.norm"
    if first == "np" and (rest in NUMPY or rest.startswith("linalg.")):
        return name
    if first == "math" and rest in MATH:
        return name
    if first == "cv2" and rest.partition(".")[0] not in CV2:
        return name
    if first in SCIPY and rest not in SCIPY[first]:
        return name
    return None


def test_the_way_to_a_map_rounds_in_one_way_only():
    judged = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in PATHS}
    rounding = {name: found for name, text in judged.items() if (found := list(forbidden_in(text)))}
    assert rounding.keys() == EXEMPT.keys(), {name: rounding[name] for name in rounding.keys() - EXEMPT.keys()}


@pytest.mark.parametrize("line", [
    "c = a @ b", "a @= b", "x = np.linalg.solve(a, b)", "x = np.linalg.norm(a)", "x = np.exp(a)", "x = math.pow(a, b)",
    "x = a.dot(b)", "x = a ** 3", "x = np.argsort(a)", "x = cv2.GaussianBlur(a, (0, 0), 1)",
    "from scipy.linalg import eigh", "x = ndimage.gaussian_filter(a, 1)", "@numba.njit(fastmath=True)\ndef f(): ...",
    "@kernel(parallel=True)\ndef f(): ...",
])  # fmt: skip
def test_what_rounds_as_its_processor_does_is_found(line):
    assert len(list(forbidden_in(line))) == 1


def test_sums_and_norms_along_an_axis_go_from_first_to_last():
    values = np.random.default_rng(0).normal(size=(50, 7)) * 10.0 ** np.arange(-3, 4)
    for row in values:
        total = squares = 0.0
        for value in row.tolist():
            total += value
            squares += value * value
        assert row.sum() == total
        assert np.linalg.norm(row[None], axis=1)[0] == np.sqrt(squares)
