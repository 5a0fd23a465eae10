# Planes depend on the arm alone. A campaign of the same shipped arm as one before it takes the planes
# of that one, under its own name.
FIRST_OF_ARM = {}
SAME_ARM = {}
for campaign in () if isinstance(FLEET, str) else SETTINGS.campaigns:
    folder = Path(SETTINGS.raw_dir, campaign)
    robot = robot_name(folder)
    if (
        robot
        and not arm_files(folder)
        and campaign not in IMPORTED
        and not by_general_model(campaign)
    ):
        first = FIRST_OF_ARM.setdefault(robot, campaign)
        if first != campaign:
            SAME_ARM[campaign] = first


rule montecarlo:
    """Position error from resolver uncertainty in horizontal planes."""
    input:
        campaign=ancient(raw("campaign.yaml")),  # its name and robot are parameters below
        arm=arm_of_campaign,
        same=lambda wildcards: (
            expand(rules.montecarlo.output, campaign=SAME_ARM[wildcards.campaign])
            if wildcards.campaign in SAME_ARM
            else []
        ),
    output:
        expand(
            result("montecarlo/z{plane}.json"),
            plane=SETTINGS.montecarlo.planes_mm,
            allow_missing=True,
        ),
    log:
        result("logs/montecarlo.log"),
    params:
        code=code_of("pa10cal.commands.montecarlo"),
        name=name_of_campaign,
        robot=robot_of_campaign,
        folder=campaign_folder,
        out=lambda wildcards, output: os.path.dirname(output[0]),
        same=lambda wildcards, input: (
            f"--same-arm {shlex.quote(os.path.dirname(input.same[0]))}" if input.same else ""
        ),
        settings=settings_of("montecarlo"),
    shell:
        "python -m pa10cal montecarlo --campaign {params.name:q} --robot {params.robot:q}"
        " --campaign-dir {params.folder:q} --settings {params.settings:q} --out {params.out:q}"
        " --skip-out-of-reach {params.same}"
        " 2>&1 | tee {log:q} >&2"
