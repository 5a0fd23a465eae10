# The pictures of a study of blind trials, and what the report calls them.
TRIAL_FIGURES = {
    "trials_confusion": "What was hidden, and what was named",
    "trials_power": "How large an effect must be to be found",
    "trials_false_names": "How often a verdict is wrong",
    "trials_intervals": "Whether intervals of effects hold the truth",
}
TRIAL_TABLES = {"trials_summary": "Figures to reach, and those reached"}


rule blind_trials:
    """Every blind trial, scored: wrong names, missed names, power, intervals."""
    input:
        expand(trial_result("scores.json"), study="blind_trials"),
        expand(trial_result("figures/{name}.svg"), study="blind_trials", name=TRIAL_FIGURES),
        expand(trial_result("tables/{name}.csv"), study="blind_trials", name=TRIAL_TABLES),


rule blind_trials_reduced:
    """A few of them, as a check that verdicts are still what they were."""
    input:
        expand(trial_result("scores.json"), study="blind_trials_reduced"),
        expand(trial_result("figures/{name}.svg"), study="blind_trials_reduced", name=TRIAL_FIGURES),
        expand(trial_result("tables/{name}.csv"), study="blind_trials_reduced", name=TRIAL_TABLES),


rule judge_trials:
    """Some trials of one kind: hidden, measured, judged; the truth goes into a file apart."""
    input:
        code=code_of("commands.blind_trials"),
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
        seed=SETTINGS.blind_trials.random_seed,
        settings=sections_of("ingest", "calibration", "discovery"),
    shell:
        "python -m pa10cal blind_trials --kind {wildcards.kind} --first {wildcards.first}"
        " --count {wildcards.trials} --random-seed {params.seed} --settings {params.settings:q}"
        " --verdicts {output.verdicts:q} --truths {output.truths:q} 2>&1 | tee {log:q} >&2"


rule score_trials:
    """Verdicts against truths: the one rule that reads a truth."""
    input:
        verdicts=trial_chunks("verdicts.jsonl"),
        truths=trial_chunks("truths.jsonl"),
        code=code_of("commands.score_trials"),
    output:
        scores=trial_result("scores.json"),
        trials=trial_result("trials.csv"),
    log:
        trial_result("logs/score_trials.log"),
    wildcard_constraints:
        study="|".join(TRIAL_STUDIES),
    shell:
        "python -m pa10cal score_trials --verdicts {input.verdicts:q} --truths {input.truths:q}"
        " --scores {output.scores:q} --trials {output.trials:q} 2>&1 | tee {log:q} >&2"


for name, title in {**TRIAL_FIGURES, **TRIAL_TABLES}.items():

    rule:
        name:
            name
        input:
            scores=trial_result("scores.json"),
            code=code_of("commands.trial_figures", f"figures.{name}"),
        output:
            **(
                {
                    "svg": reported_trials(f"figures/{name}.svg", name, title),
                    "pdf": trial_result(f"figures/{name}.pdf"),
                    "png": trial_result(f"figures/{name}.png"),
                }
                if name in TRIAL_FIGURES
                else {
                    "html": reported_trials(f"tables/{name}.html", name, title),
                    "csv": trial_result(f"tables/{name}.csv"),
                    "markdown": trial_result(f"tables/{name}.md"),
                }
            ),
        log:
            trial_result(f"logs/{name}.log"),
        wildcard_constraints:
            study="|".join(TRIAL_STUDIES),
        params:
            name=name,
            out=lambda wildcards, output: os.path.dirname(output[0]),
            settings=settings_of("figures"),
        shell:
            "python -m pa10cal trial_figures --figure {params.name} --scores {input.scores:q}"
            " --settings {params.settings:q} --out-dir {params.out:q} 2>&1 | tee {log:q} >&2"
