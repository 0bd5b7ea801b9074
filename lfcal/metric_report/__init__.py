"""The report of a metric calibration: residuals, poses, reliability of the errors, what to shoot
next.
"""
