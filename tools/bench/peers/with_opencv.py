"""OpenCV's pyramidal Lucas-Kanade: a translation per point. No DIC, but the speed that a window costs at least."""

import cv2
import numpy as np
from serve import serve

cv2.setNumThreads(1)


def prepare(reference, setup):
    x0, y0, x1, y1 = setup["region"]
    half, step = setup["subset_size"] // 2, setup["step"]
    xs, ys = np.arange(x0 + half, x1 - half + 1, step), np.arange(y0 + half, y1 - half + 1, step)
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 1, 2).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, setup["tolerance_px"])

    def correlate(target):
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            reference, target, points, None, winSize=(2 * half + 1, 2 * half + 1), maxLevel=3, criteria=stop
        )
        away = np.where(status[:, :, None] == 1, moved - points, np.nan)[:, 0]
        return {"x": points[:, 0, 0], "y": points[:, 0, 1], "u": away[:, 0], "v": away[:, 1]}

    return correlate


serve(prepare)
