"""Example commands, two or three for every verb, shown at the end of its help."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": (
        "recon demo",
        "recon demo --out pages --overwrite",
    ),
    "fit": (
        "recon fit film.mp4 --out motion.npz",
        "recon fit views/ --camera calibration.toml --frame-rate 30 --out motion.npz",
        "recon fit keypoints.json --frame-rate 30 --person all --out people/",
    ),
    "detect": (
        "recon detect film.mp4 --out keypoints.npz",
        "recon detect film.mp4 --detector pose_landmark_heavy.tflite --out keypoints.npz",
    ),
    "complete": (
        "recon complete scans/ --frame-rate 5 --out motion.npz",
        "recon complete landmarks.npz --prior anchor --between 1.0 2.2 --out cycle.npz",
    ),
    "batch": (
        "recon batch clips.jsonl --out results",
        "recon batch clips.jsonl --out results --shard 0/4 --prior pose",
    ),
    "stream": (
        "recon stream seen.npz < moments.jsonl > motion.jsonl",
        "recon stream --lag 5 view_1.npz view_2.npz < moments.jsonl",
    ),
    "convert": (
        "recon convert walk.c3d walk.npz",
        "recon convert recordings/ motions/ --all --processes 4",
    ),
    "label": (
        "recon label trial.c3d --like named.c3d --out labelled.c3d",
        "recon label walk.trc --set pig --unit mm --out named.trc",
    ),
    "convert-all": (
        "recon convert-all recordings/ motions/",
        "recon convert-all recordings/ motions/ --processes 4 --body smpl.npz",
    ),
    "fit-all": (
        "recon fit-all keypoints.json --frame-rate 30 --out people/",
        "recon fit-all views/ --camera calibration.toml --frame-rate 30 --out people/",
    ),
    "sample": (
        "recon sample --out walk.npz --seconds 4",
        "recon sample --prior humos --shape woman,height=1.65 --count 5 --out samples/",
    ),
    "predict": (
        "recon predict motion.npz --out next.npz --seconds 1.5",
        "recon predict motion.npz --out futures/ --samples 8 --at 2.0",
    ),
    "interpolate": (
        "recon interpolate walk.npz run.npz --out between.npz",
        "recon interpolate walk.npz run.npz --out near.npz --at 0.25",
    ),
    "refine": (
        "recon refine hmr4d_results.pt --frame-rate 30 --out motion.npz",
        "recon refine wham_output.pkl --frame-rate 30 --shape height=1.80 --out motion.npz",
    ),
    "retarget": (
        "recon retarget motion.npz --shape height=1.80,weight=75 --out taller.npz",
        "recon retarget motion.npz --shape=-1,2 --out other.npz",
    ),
    "simulate": (
        "recon simulate motion.npz seen.npz --kind joints3d --noise 0.02",
        "recon simulate motion.npz views/ --kind keypoints2d --views 3 --noise 2",
    ),
    "evaluate": (
        "recon evaluate motion.npz truth.npz",
        "recon evaluate motion.npz truth.npz --obs seen.npz --json metrics.json",
    ),
    "bench": (
        "recon bench noisy-joints --only 1",
        "recon bench hidden-points --method pose own_method:Mine --corpus motions/",
        "recon bench gap --corpus motions/ --write windows/",
        "recon bench gap --corpus motions/ --predictions answers/",
    ),
    "report": (
        "recon report trial.c3d",
        "recon report motion.npz --out gait.html",
    ),
    "view": (
        "recon view motion.npz --html motion.html --obs seen.npz",
        "recon view motion.npz --compare truth.npz --mp4 both.mp4",
        "recon view motion.npz --film film.mp4 --png sheet.png",
    ),
    "export": (
        "recon export motion.npz --glb motion.glb --names mixamo",
        "recon export motion.npz --trc motion.trc --markers opencap --mot motion.mot",
        "recon export motion.npz --forces grf.mot --moments id.sto --mass 70",
    ),
    "register": (
        "recon register left/ right/ --camera lens.npz --frame-rate 30 --out rig",
        "recon register front.npz side.npz back.npz --out rig",
    ),
    "calibrate": (
        "recon calibrate left.mp4 right.mp4 --height 1.80 --out rig.toml",
        "recon calibrate board1.mp4 board2.mp4 --board 9x6 --square 25mm --out rig.toml",
        "recon calibrate cam1_json/ cam2_json/ cam3_json/ --frame-rate 60 --out rig.toml",
    ),
    "info": (
        "recon info motion.npz",
        "recon info walk.c3d --json",
    ),
}
"""Examples by verb."""
