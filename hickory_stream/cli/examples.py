"""First sentence and example of the help of each command."""

from __future__ import annotations

TEXTS: dict[str, tuple[str, str]] = {
    "play": (
        "Map a recorded log: find its objects and write a map folder, which every other command reads.",
        "play demo.mcap --out demo.map --rrd demo.rrd",
    ),
    "live": (
        "Map a robot while it moves: what arrives is mapped, losses are reported, and ROS need not be installed.",
        "live zenoh://b2.local --out robot.map --for 60",
    ),
    "batch": (
        "Map many logs into OUT/maps, each by a process of its own, here or on a Dask cluster whose machines share the "
        "disks. What was mapped before is left alone, what was interrupted is gone on with. In OUT: batch.html and "
        "result.json; with --merge also merged.map of the maps that overlap.",
        "batch monday/*.mcap -o monday --workers 2 --merge",
    ),
    "fleet": (
        "Map several robots in one run, a process each: their maps are aligned while they grow, robots that agree "
        "share one frame from then on, and the finished maps become one. In OUT: NAME.map of each robot, fleet.map, "
        "fleet.rrd and fleet.json.",
        "fleet --robot alice=alice.mcap --robot bob=bob.mcap -o out",
    ),
    "resume": (
        "Go on with a playback that was killed, stopped or broken off, to the map that it would have become.",
        "resume demo.map --source /mnt/logs/demo.mcap",
    ),
    "replay": (
        "Repeat a recorded run from its journal alone, and compare the map that comes out.",
        "replay demo.map --rrd again.rrd",
    ),
    "doctor": (
        "Examine a log, or for ten seconds a robot, before it is mapped: what would be played, what is damaged, and "
        "what becomes of every message.",
        "doctor camera.bag vio.bag --html page.html",
    ),
    "odometry": (
        "Estimate where the camera was from the LiDAR or the depth images of a log, and compare with the truth.",
        "odometry demo.mcap -o poses.tum --pose-topic none --truth demo.mcap",
    ),
    "inspect": (
        "Show what a map holds: every object with its layers, what they take and how long they took.",
        "inspect demo.map --at 12.5",
    ),
    "render": (
        "Draw a map from above and in perspective, without a screen.",
        "render demo.map -o demo.png --layers 3,4",
    ),
    "export": ("Write a map in a format that other programs read.", "export demo.map --format glb -o demo.glb"),
    "diff": (
        "Tell what happened to the objects between two moments of a run, or from one map of a place to a later one: "
        "still there, moved, gone, new, exchanged, or not seen; exit status 3 where the maps do not align.",
        "diff monday.map tuesday.map -o changes.html",
    ),
    "query": (
        "Find the objects of a map that a question asks for, or count them: by size, shape, colour, height and how "
        "they lie to one another.",
        'query demo.map "something to sit on near object 7" -o answer.png',
    ),
    "plan": (
        "Plan a path through a map for a robot, or say why there is none.",
        "plan demo.map --start 1,1 --goal -1,-1 --robot jackal -o plan.png",
    ),
    "align": (
        "Find where one map lies in another one, how sure that is, or why it cannot be said.",
        "align monday.map tuesday.map -o join.png",
    ),
    "merge": (
        "Make one map of several that overlap; the inputs are not changed.",
        "merge monday.map tuesday.map -o both.map",
    ),
    "relocalise": (
        "Play a log and find its place in a stored map while it plays.",
        "relocalise all.map today.mcap --until-found",
    ),
    "reconstruct": (
        "Repeat by hand a shape job that failed, from the input that the map kept.",
        "reconstruct demo.map/failed/000012",
    ),
    "evaluate": (
        "Compare a map with the truth of its log: objects, surfaces, containment, poses and masks.",
        "evaluate demo.map --truth demo.truth --html demo.html",
    ),
    "explain": (
        "Say why something is not in a map, or how it came to be there: what every keyframe took it for, and what "
        "became of its masks and tracks.",
        "explain demo.map --truth demo.truth --object 3",
    ),
    "segment": (
        "Segment one frame and draw masks, rejected masks with their reasons, and features.",
        "segment color.png depth.png --intrinsics 525,525,319.5,239.5 -o segments.png",
    ),
    "models": ("Manage the networks of this machine; nothing is ever downloaded.", "models list"),
    "models where": ("Print the folder of models.", "models where"),
    "models list": ("List the models, and whether their hashes are right.", "models list --json"),
    "models add": (
        "Copy an ONNX file to the folder of models, with an entry in its manifest.",
        "models add my.onnx --kind semantic --labels names.txt",
    ),
    "generators": (
        "The programs that make shapes here, each described by a TOML; nothing is ever downloaded.",
        "generators list",
    ),
    "generators list": ("List the generators, their licences, and what they lack.", "generators list --json"),
    "generators check": (
        "Start a generator and give it a built-in object: versions, seconds, memory, and a picture of what it made.",
        "generators check triposr -o check.png",
    ),
    "models check": (
        "Run a model on a built-in picture: provider, warm-up, time, and what it gives.",
        "models check fastsam-s -o check.png",
    ),
    "config": ("Show or check a configuration.", "config dump"),
    "config dump": (
        "Print the whole configuration as TOML, with what was set.",
        "config dump --set mapper.run.workers=4",
    ),
    "config check": ("Refuse a configuration file with misspelt keys or wrong values.", "config check my.toml"),
    "cache": (
        "Show or clear what is kept to save time, in $HICKORY_CACHE or the user's caches: at most "
        "$HICKORY_CACHE_MB megabytes (default 4000). Nothing is lost with it.",
        "cache show",
    ),
    "cache show": ("Print where the caches lie and how much is in them, by kind.", "cache show --json"),
    "cache clear": ("Remove all caches, or some kinds of them.", "cache clear kernels shapes"),
    "schema": ("Print the JSON Schema of what --json prints.", "schema inspect"),
    "verify": (
        "Prove anew what a map says of itself: digest, journal, files, and layer 4 from the meshes.",
        "verify demo.map",
    ),
    "demo": ("Make a small recording of a synthetic room, map it and draw the map.", "demo --out my-demo"),
    "completion": (
        "Print a script that completes commands, options and their values in a shell.",
        "completion bash > ~/.local/share/bash-completion/completions/hickory-stream",
    ),
}
