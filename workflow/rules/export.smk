rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        calibration=result("calibration"),
        extended=result("discovery/extended.json"),
    output:
        model=result("model/model.yaml"),
        covariance=result("model/model.covariance.npz"),
        urdf=result("model/robot.urdf"),
    log:
        result("logs/export.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("commands.export"),
    shell:
        "python -m pa10cal export --calibration {params.calibration:q} --extended {input.extended:q}"
        " --model {output.model:q} --urdf {output.urdf:q} --force 2>&1 | tee {log:q} >&2"
