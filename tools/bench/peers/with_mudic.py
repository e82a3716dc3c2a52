"""muDIC: global DIC with four-node elements, as wide as a subset, so that a node sees about as many pixels."""

import muDIC
import numpy as np
from muDIC.solver.correlate import DICInput
from serve import serve


def prepare(reference, setup):
    x0, y0, x1, y1 = setup["region"]
    half = setup["subset_size"] // 2
    low_x, low_y, high_x, high_y = x0 + half, y0 + half, x1 - half, y1 - half
    count = round((high_x - low_x) / (setup["subset_size"] - 1))

    def correlate(target):
        images = muDIC.IO.image_stack.ImageStack(
            muDIC.IO.image_stack.ImageListWrapper([image.astype(float) for image in (reference, target)])
        )
        mesh = muDIC.Mesher(deg_e=1, deg_n=1, type="q4").mesh(
            images, Xc1=low_x, Xc2=high_x, Yc1=low_y, Yc2=high_y, n_elx=count, n_ely=count, GUI=False
        )
        settings = DICInput(mesh, images)
        settings.tol = setup["tolerance_px"]
        settings.maxit = 40
        settings.max_nr_im = 2
        settings.interpolation_order = 3
        settings.store_internals = False
        result = muDIC.DICAnalysis(settings).run()
        x, y = np.asarray(result.xnodesT), np.asarray(result.ynodesT)
        return {"x": x[:, 0], "y": y[:, 0], "u": x[:, 1] - x[:, 0], "v": y[:, 1] - y[:, 0]}

    return correlate


serve(prepare)
