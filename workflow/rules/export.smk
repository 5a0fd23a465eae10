rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=result("calibration/combined.json"),
        extended=result("discovery/extended.json"),
    output:
        model=result("model/model.yaml"),
        covariance=result("model/model.covariance.npz"),
        urdf=result("model/robot.urdf"),
        dh=result("model/dh.csv"),
    log:
        result("logs/export.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("stages.export"),
        folder=campaign_folder,
    shell:
        "python -m pa10cal export --calibration {params.calibration:q} --extended {input.extended:q}"
        " --campaign-dir {params.folder:q} --poses {input.poses:q} --model {output.model:q}"
        " --urdf {output.urdf:q} --dh {output.dh:q} --force 2>&1 | tee {log:q} >&2"
