"""pyvale: multi-window, then reliability-guided IC-GN in C++. Writes its result to a file, as its only way out."""

import tempfile
from pathlib import Path

import numpy as np
from pyvale import dic
from serve import serve


def prepare(reference, setup):
    low, high = np.array(setup["region"][:2]), np.array(setup["region"][2:])
    mask = np.zeros(reference.shape, bool)
    mask[low[1] : high[1] + 1, low[0] : high[0] + 1] = True
    kernel, sigma = (5, setup["blur_px"]) if setup.get("blur_px") else (1, 1.0)

    def correlate(target):
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            dic.calculate_2d(
                reference=reference,
                deformed=target[None],
                roi_mask=mask,
                seed=[int(v) for v in setup.get("seed", (low + high) // 2)],
                subset_size=setup["subset_size"],
                subset_step=setup["step"],
                precision=setup["tolerance_px"],
                max_displacement=setup.get("max_displacement_px", 64),
                num_threads=1,
                image_filter_kernel=kernel,
                image_filter_sigma=sigma,
                output_basepath=folder,
                print_level=0,
            )
            found = dic.import_2d(str(Path(folder) / "dic_results_*.csv"), ",", layout="column", print_level=0)
        return {"x": found.ss_x, "y": found.ss_y, "u": found.u_px[0], "v": found.v_px[0]}

    return correlate


serve(prepare)
