rule montecarlo:
    """Position error from resolver uncertainty in horizontal planes."""
    input:
        campaign=ancient(raw("campaign.yaml")),  # its name and robot are parameters below
        arm=arm_of_campaign,
    output:
        expand(
            result("montecarlo/z{plane}.json"),
            plane=SETTINGS.montecarlo.planes_mm,
            allow_missing=True,
        ),
    log:
        result("logs/montecarlo.log"),
    params:
        code=code_of("commands.montecarlo"),
        name=name_of_campaign,
        robot=robot_of_campaign,
        folder=campaign_folder,
        out=lambda wildcards, output: os.path.dirname(output[0]),
        settings=settings_of("montecarlo"),
    shell:
        "python -m pa10cal montecarlo --campaign {params.name:q} --robot {params.robot:q}"
        " --campaign-dir {params.folder:q} --settings {params.settings:q} --out {params.out:q}"
        " 2>&1 | tee {log:q} >&2"
