"""Reads a .mat file in a separate process, which `mat` starts; imports nothing of recon.

scipy's reader can crash the interpreter on damaged files; there only this process ends. Every
struct with data, markerName and freq goes to standard output, as one .npz of plain arrays.
"""

import io
import sys
from typing import Any

import numpy as np

MEMORY, SECONDS = 3 << 29, 15
"""Bytes and seconds of computing that a file may take, where the system can limit them."""
FIELDS = ("data", "markerName", "freq")


def fields_of_recordings(path: str) -> dict[str, np.ndarray]:
    """Read the fields of every recording in a file, keyed as NAME/FIELD."""
    from scipy.io import loadmat

    found: dict[str, np.ndarray] = {}
    for name, value in loadmat(path, squeeze_me=True).items():
        fields = getattr(getattr(value, "dtype", None), "names", None) or ()
        if not set(FIELDS) <= set(fields) or value.shape != ():
            continue
        item: dict[str, Any] = {field: value[field].item() for field in FIELDS}
        labels = [str(label).strip() for label in np.atleast_1d(item["markerName"])]
        if labels and np.size(item["freq"]) == 1:
            found[f"{name}/data"] = np.asarray(item["data"], dtype=np.float64)
            found[f"{name}/markerName"] = np.array(labels)
            found[f"{name}/freq"] = np.asarray(item["freq"], dtype=np.float64)
    return found


def limit_memory() -> None:
    """Limit this process's memory, so that a huge file ends it and not the machine."""
    try:
        import resource
    except ImportError:  # Windows lacks the module `resource`
        return
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))


if __name__ == "__main__":
    limit_memory()
    buffer = io.BytesIO()
    arrays: dict[str, Any] = fields_of_recordings(sys.argv[1])
    np.savez(buffer, allow_pickle=False, **arrays)
    sys.stdout.buffer.write(buffer.getvalue())
