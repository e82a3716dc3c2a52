"""al-dic: FFT search, then local IC-GN (Numba); the global step is off, which is its subset DIC.

The step must be a power of two and the subset even, plus the centre pixel.
"""

import numpy as np
from al_dic import dicpara_default, run_aldic
from al_dic.core.data_structures import GridxyROIRange
from serve import serve


def prepare(reference, setup):
    x0, y0, x1, y1 = setup["region"]
    half = setup["subset_size"] // 2
    parameters = dicpara_default(
        gridxy_roi_range=GridxyROIRange(gridx=(x0 + half, x1 - half), gridy=(y0 + half, y1 - half)),
        img_size=reference.shape,
        winsize=setup["subset_size"] - 1,
        winstepsize=8,
        winsize_min=8,
        tol=setup["tolerance_px"],
        use_global_step=False,
        reference_mode="accumulative",
        show_plots=False,
    )
    masks = [np.ones(reference.shape)] * 2

    def correlate(target):
        images = [image.astype(float) / 255 for image in (reference, target)]
        result = run_aldic(parameters, images, masks, compute_strain=False)
        centres = result.dic_mesh.coordinates_fem
        moved = result.result_disp[0].U
        return {"x": centres[:, 0], "y": centres[:, 1], "u": moved[0::2], "v": moved[1::2]}

    return correlate


serve(prepare)
