"""Description and example of each command."""

TEXTS: dict[str, tuple[str, str]] = {
    "play": (
        "Map a recorded log: find its objects and write a map folder, which every other command reads.",
        "play demo.mcap --out demo.map --rrd demo.rrd",
    ),
    "live": (
        "Map a robot while it moves; messages that are lost are reported, and ROS is not necessary.",
        "live zenoh://b2.local --out robot.map --for 60",
    ),
    "batch": (
        "Map many logs into OUT/maps, a process each, on this machine or on a Dask cluster with shared disks. "
        "Finished maps are kept, interrupted ones resumed. OUT gets batch.html and result.json, with --merge also "
        "merged.map of overlapping maps. Exit status 3: not all logs are mapped.",
        "batch monday/*.mcap -o monday --workers 2 --merge",
    ),
    "fleet": (
        "Map several robots in one run, a process each. Growing maps are aligned, matching robots share one frame, "
        "and the finished maps are merged. OUT gets NAME.map of each robot, fleet.map, fleet.rrd and fleet.json. "
        "Exit status 3: not all robots are in one map.",
        "fleet --robot alice=alice.mcap --robot bob=bob.mcap -o out",
    ),
    "resume": (
        "Continue an interrupted playback; the map becomes the same as without the interruption.",
        "resume demo.map --source /mnt/logs/demo.mcap",
    ),
    "replay": ("Repeat a recorded run from its journal, and compare the maps.", "replay demo.map --rrd again.rrd"),
    "doctor": (
        "Examine a log, or a robot for ten seconds, before mapping: its streams, its damage, and the use of every "
        "message. Exit status 0: sound; 3: usable with losses; 2: unusable.",
        "doctor camera.bag vio.bag --html page.html",
    ),
    "odometry": (
        "Estimate the camera's trajectory from the LiDAR or the depth images of a log, and compare it with the truth.",
        "odometry demo.mcap -o poses.tum --pose-topic none --truth demo.mcap",
    ),
    "inspect": (
        "List the objects of a map: place, size, colour and support. --layers adds storage and computing times.",
        "inspect demo.map --near 1,2",
    ),
    "render": (
        "Draw a map from above and in perspective, without a screen.",
        "render demo.map -o demo.png --layers 3,4",
    ),
    "export": ("Write a map in a format of other programs.", "export demo.map -o demo.html"),
    "diff": (
        "Compare two moments of a run, or two maps of a place: objects are still there, moved, gone, new, "
        "exchanged, or not seen. Exit status 3: the maps do not align.",
        "diff monday.map tuesday.map -o changes.html",
    ),
    "query": (
        "Find or count the objects of a map that answer a question, about size, shape, colour, height and "
        "relations. Exit status 3: no object answers.",
        'query demo.map "something to sit on near object 7" -o answer.png',
    ),
    "plan": (
        "Plan a path through a map for a robot, or say why there is none. Exit status 3: there is no path.",
        "plan demo.map --start 1,1 --goal -1,-1 --robot jackal -o plan.png",
    ),
    "align": (
        "Find the transform between two overlapping maps and its uncertainty, or say why there is none. Exit status"
        " 3: no alignment was found.",
        "align monday.map tuesday.map -o join.png",
    ),
    "merge": (
        "Combine several overlapping maps into one; the inputs are not changed.",
        "merge monday.map tuesday.map -o both.map",
    ),
    "relocalise": ("Play a log and locate it in a stored map.", "relocalise all.map today.mcap --until-found"),
    "reconstruct": (
        "Repeat a failed shape job from the input that the map kept.",
        "reconstruct demo.map/failed/000012",
    ),
    "evaluate": (
        "Compare a map with the truth of its log: objects, surfaces, containment, poses and masks.",
        "evaluate demo.map --truth demo.truth --html demo.html",
    ),
    "explain": (
        "Explain why a map lacks an object, or how an object came into it: its label in every keyframe, and the "
        "history of its masks and tracks.",
        "explain demo.map --truth demo.truth --object 3",
    ),
    "segment": (
        "Segment one frame and draw masks, rejected masks with reasons, and features.",
        "segment color.png depth.png --intrinsics 525,525,319.5,239.5 -o segments.png",
    ),
    "models": ("Manage the networks of this machine; only `models get` downloads.", "models list"),
    "models where": ("Print the folder of models ($HICKORY_MODELS).", "models where"),
    "models list": ("List the models, and check their hashes.", "models list --json"),
    "models get": (
        "Fetch published weights, export them to ONNX, and compare the graph with the package's own prediction.",
        "models get fastsam-s --yes",
    ),
    "models add": (
        "Copy a network to the folder of models, with an entry in its manifest; weights are exported to ONNX first.",
        "models add my.onnx --kind semantic --labels names.txt",
    ),
    "generators": (
        "List or check the shape generators of this machine, each described by a TOML file; nothing is downloaded.",
        "generators list",
    ),
    "generators list": (
        "List the generators of $HICKORY_GENERATORS, their licences, and missing files.",
        "generators list --json",
    ),
    "generators check": (
        "Start a generator with a built-in object: report versions, time and memory, and draw its mesh.",
        "generators check triposr -o check.png",
    ),
    "models check": (
        "Run a model on a built-in picture: report provider, warm-up, time and results.",
        "models check fastsam-s -o check.png",
    ),
    "config": ("Show or check a configuration.", "config dump"),
    "config dump": (
        "Print the whole configuration as TOML, with the given values.",
        "config dump --set mapper.run.workers=4",
    ),
    "config check": (
        "Check a configuration file; misspelt keys and invalid values are refused.",
        "config check my.toml",
    ),
    "cache": (
        "Show or clear cached kernels, shapes and recordings, which are computed again when needed. They lie in "
        "$HICKORY_CACHE or the user's cache folder, at most $HICKORY_CACHE_MB megabytes (default 4000).",
        "cache show",
    ),
    "cache show": ("Print the folder of the caches and their sizes by kind.", "cache show --json"),
    "cache clear": ("Remove all caches, or some kinds of them.", "cache clear kernels shapes"),
    "schema": ("List the --json outputs, or print the JSON Schema of one.", "schema inspect"),
    "verify": (
        "Check the digest, journal and files of a map, and prove layer 4 from the meshes. Exit status 1: a check "
        "failed.",
        "verify demo.map",
    ),
    "demo": ("Make a small recording of a synthetic room, map it and draw the map.", "demo --out my-demo"),
    "completion": (
        "Print a script that completes commands, options and values in a shell.",
        "completion bash > ~/.local/share/bash-completion/completions/hickory-stream",
    ),
}
