"""The figures of the paper's tables, to stand beside the measured ones."""
# Tables `tab:reconstruction_avg`, `tab:representation_storage_runtime`, `tab:reloc_eval_full` and `tab:nav_eval`;
# measured by its authors with SAM 3D, DINO features and an RTX 4090 on the data sets themselves.

# Mean F1, and the share of objects with an ADD-S below 0.05 (HOPE) or 0.1 (ReplicaCAD) of their diameter.
VIEWS = {
    "initial": {"hope": (0.9141, 0.7600), "replica_cad": (0.8395, 0.7317)},
    "max_area": {"hope": (0.9215, 0.8200), "replica_cad": (0.8566, 0.7886)},
    "max_box": {"hope": (0.8977, 0.8300), "replica_cad": (0.8619, 0.7628)},
    "max_volume": {"hope": (0.8472, 0.7000), "replica_cad": (0.8649, 0.7398)},
    "s_score": {"hope": (0.9312, 0.8400), "replica_cad": (0.8721, 0.7967)},
}

# Layer -> data set -> (KiB, seconds); objects of each data set.
STORAGE: dict[int, dict[str, tuple[float, float]]] = {
    1: {"hope": (61.04, 61.32), "replica_cad": (408.61, 124.61), "kimera_multi": (703.26, 231.34),
        "nus_clb": (471.69, 182.83)},
    2: {"hope": (232.46 * 1024, 167.63), "replica_cad": (437.12 * 1024, 345.12),
        "kimera_multi": (324.69 * 1024, 349.28), "nus_clb": (483.84 * 1024, 392.51)},
    3: {"hope": (51.12, 68.12), "replica_cad": (73.34, 165.23), "kimera_multi": (62.78, 151.67),
        "nus_clb": (52.48, 172.26)},
    4: {"hope": (51.12, 17.12), "replica_cad": (73.34, 43.92), "kimera_multi": (62.78, 38.26),
        "nus_clb": (52.48, 35.36)},
}  # fmt: skip
NUM_OBJECTS = {"hope": 16.67, "replica_cad": 42.25, "kimera_multi": 41.83, "nus_clb": 40.0}

# By method: the four apartments of ReplicaCAD and the three scenes of Kimera-Multi; pairs of objects, and the error of
# the transform in metres and degrees.
ALIGNMENT: dict[str, dict[str, list[tuple[int, float, float]]]] = {
    "bbox": {
        "replica_cad": [(21, 0.0503, 1.0367), (28, 0.1363, 2.0622), (24, 0.0363, 0.4211), (24, 0.0511, 0.3429)],
        "kimera_multi": [(15, 0.4700, 2.6211), (24, 0.1270, 0.6898), (10, 1.6137, 8.3873)],
    },
    "roman-xl": {
        "replica_cad": [(21, 0.0474, 1.0280), (21, 0.0286, 1.3962), (14, 0.0646, 2.8784), (25, 0.0195, 1.5031)],
        "kimera_multi": [(26, 0.4963, 0.2634), (28, 0.4558, 0.0806), (28, 1.4948, 0.2006)],
    },
    "roman-one": {
        "replica_cad": [(47, 0.0301, 0.6063), (38, 0.0189, 0.7057), (50, 0.0285, 0.4921), (43, 0.0438, 0.3822)],
        "kimera_multi": [(58, 0.0789, 0.1697), (36, 0.5276, 0.0884), (27, 3.2629, 0.8326)],
    },
    "sq": {
        "replica_cad": [(19, 0.0421, 0.3423), (26, 0.0474, 0.8282), (21, 0.0244, 0.2325), (23, 0.0437, 0.1890)],
        "kimera_multi": [(15, 0.1117, 0.1041), (23, 0.1275, 0.2580), (9, 0.4952, 1.3133)],
    },
}

# Success in percent, straight line over path, seconds to build the occupancy grid, share of free space.
NAVIGATION = {
    "mesh-obb": (89.8, 0.742, 0.014, 0.692),
    "mesh-full": (100.0, 0.893, 209.192, 0.838),
    "layer-4": (100.0, 0.885, 0.271, 0.812),
}
