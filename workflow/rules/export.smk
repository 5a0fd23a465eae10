rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        calibration=result(f"calibration/{SETTINGS.evaluation.calibration}.json"),
        extended=result("discovery/extended.json"),
        arm=arm_of_campaign,
        code=code_of("stages.export"),
    output:
        model=result("model/model.yaml"),
        urdf=result("model/robot.urdf"),
    log:
        result("logs/export.log"),
    params:
        folder=campaign_folder,
    shell:
        "python -m pa10cal export --campaign-dir {params.folder:q}"
        " --calibration {input.calibration:q} --extended {input.extended:q}"
        " --model {output.model:q} --urdf {output.urdf:q} 2>&1 | tee {log:q} >&2"
