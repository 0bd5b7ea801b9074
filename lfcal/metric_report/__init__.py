"""Report of a metric calibration: residuals, poses, reliability, what to shoot next."""
