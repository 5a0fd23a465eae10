rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        calibration=result(f"calibration/{SETTINGS.evaluation.calibration}.json"),
        extended=extended_model,
        arm=arm_of_campaign,
        code=code_of("commands.export"),
    output:
        model=result("model/model.yaml"),
        urdf=result("model/robot.urdf"),
    log:
        result("logs/export.log"),
    params:
        folder=campaign_folder,
        extended=extended_option,
    shell:
        "python -m pa10cal export --campaign-dir {params.folder:q}"
        " --calibration {input.calibration:q} {params.extended}"
        " --model {output.model:q} --urdf {output.urdf:q} 2>&1 | tee {log:q} >&2"
