rule montecarlo:
    """Position error from resolver uncertainty in one horizontal plane."""
    input:
        campaign=ancient(raw("campaign.yaml")),  # its name and robot are parameters below
        arm=arm_of_campaign,
        code=code_of("commands.montecarlo"),
    output:
        result("montecarlo/z{plane}.json"),
    log:
        result("logs/montecarlo_z{plane}.log"),
    params:
        name=name_of_campaign,
        robot=robot_of_campaign,
        folder=campaign_folder,
        settings=settings_of("montecarlo", without=["planes_mm"]),
    shell:
        "python -m pa10cal montecarlo --campaign {params.name:q} --robot {params.robot:q}"
        " --campaign-dir {params.folder:q}"
        " --plane-mm {wildcards.plane} --settings {params.settings:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"
