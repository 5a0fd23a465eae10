rule blind_trials:
    """Every blind trial, scored: wrong names, missed names, power, intervals."""
    input:
        expand(trial_result("pictures.json"), study=("blind_trials", "blind_trials_tracked")),


rule blind_trials_tracked:
    """Those of trackers, in which no pose is repeated and blocks of poses are the judge."""
    input:
        expand(trial_result("pictures.json"), study="blind_trials_tracked"),


rule blind_trials_reflectors:
    """Those of instruments that measure no attitude: one target, three targets, a distance."""
    input:
        expand(trial_result("pictures.json"), study=REFLECTOR_STUDIES),


rule blind_trials_outside:
    """Those that hide what no name covers: which formulas are proposed."""
    input:
        expand(trial_result("pictures.json"), study=OUTSIDE_STUDIES),


rule blind_trials_reduced:
    """A few of them, as a check that verdicts are still what they were."""
    input:
        expand(trial_result("pictures.json"), study="blind_trials_reduced"),


rule wild_trials:
    """Campaigns of any arm and instrument with stressors and faults in their raw files."""
    input:
        expand(trial_result("pictures.json"), study="wild_trials"),


rule drive_trials:
    """Sensors and gears that err in one campaign or two: is the right one named?"""
    input:
        expand(trial_result("pictures.json"), study="drive_trials"),


rule blind_trials_unstated:
    """Arms whose masses nobody stated, with springs in some joints, none or all."""
    input:
        expand(trial_result("pictures.json"), study="blind_trials_unstated"),


rule blind_trials_sorted:
    """Files sorted by a joint, without a time: is a motion told that was none?"""
    input:
        expand(trial_result("pictures.json"), study="blind_trials_sorted"),


rule blind_trials_mixed:
    """Several effects at once, on arms as measured ones are, among what has no name."""
    input:
        expand(trial_result("pictures.json"), study="blind_trials_mixed"),


rule judge_trials:
    """Some trials of one kind: hidden, measured, judged; the truth goes into a file apart."""
    output:
        verdicts=trial_result("trials/{kind}_{first}_{trials}.verdicts.jsonl"),
        truths=trial_result("trials/{kind}_{first}_{trials}.truths.jsonl"),
    log:
        trial_result("logs/{kind}_{first}_{trials}.log"),
    wildcard_constraints:
        study="|".join(TRIAL_STUDIES),
        kind="[a-z_]+",
        first="[0-9]+",
        trials="[0-9]+",
    params:
        code=code_of("pa10cal_lab.command_blind_trials"),
        measured=lambda wildcards: TRIAL_STUDIES[wildcards.study][0],
        seed=SETTINGS.blind_trials.random_seed,
        settings=sections_of("ingest", "base_frame", "calibration", "discovery"),
    shell:
        "python -m pa10cal blind_trials --measured {params.measured} --kind {wildcards.kind}"
        " --first {wildcards.first}"
        " --count {wildcards.trials} --random-seed {params.seed} --settings {params.settings:q}"
        " --verdicts {output.verdicts:q} --truths {output.truths:q} 2>&1 | tee {log:q} >&2"


rule score_trials:
    """Verdicts against truths: the one rule that reads a truth."""
    input:
        verdicts=trial_chunks("verdicts.jsonl"),
        truths=trial_chunks("truths.jsonl"),
    output:
        scores=trial_result("scores.json"),
        trials=trial_result("trials.csv"),
    log:
        trial_result("logs/score_trials.log"),
    wildcard_constraints:
        study="|".join(TRIAL_STUDIES),
    params:
        code=code_of("pa10cal_lab.command_studies"),
    shell:
        "python -m pa10cal score_trials --verdicts {input.verdicts:q} --truths {input.truths:q}"
        " --scores {output.scores:q} --trials {output.trials:q} 2>&1 | tee {log:q} >&2"


rule trial_pictures:
    """The figures and the tables of a study that have something to show."""
    input:
        scores=trial_result("scores.json"),
    output:
        index=trial_result("pictures.json"),
        figures=directory(trial_result("figures")),
        tables=directory(trial_result("tables")),
    log:
        trial_result("logs/pictures.log"),
    wildcard_constraints:
        study="|".join(TRIAL_STUDIES),
    params:
        code=code_of("pa10cal.commands.figures", "pa10cal.figures.registry", "pa10cal_lab.pictures"),
        folder=lambda wildcards, input: os.path.dirname(input.scores),
        settings=sections_of("figures"),
    shell:
        "python -m pa10cal figures --results {params.folder:q} --settings {params.settings:q}"
        " 2>&1 | tee {log:q} >&2"
