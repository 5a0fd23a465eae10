# Each picture: what the report calls it, the results it is drawn from, the settings it reads.
FIGURES = {
    "fig4_test_path": {
        "title": "Fig. 4: test path",
        "needs": ["ingest/poses.parquet", "seed/base_frame.json"],
        "settings": [],
    },
    "fig5_before_after": {
        "title": "Fig. 5: error before and after calibration",
        "needs": [calibrations_of, "ingest/poses.parquet"],
        "settings": [],
    },
    "fig6_holdout": {
        "title": "Fig. 6: error at held-out points and loads",
        "needs": ["evaluation/holdout.json"],
        "settings": [],
    },
    "residual_vectors": {
        "title": "Residual vectors in space",
        "needs": ["calibration/combined.json"],
        "settings": [],
    },
    "parameter_uncertainty": {
        "title": "Parameters and their uncertainty",
        "needs": ["calibration/combined.json", "ingest/poses.parquet"],
        "settings": ["kcub_reading"],
    },
    "l_curve": {
        "title": "L-curve of the tolerance terms",
        "needs": ["calibration/combined.json"],
        "settings": [],
    },
    "montecarlo_planes": {
        "title": "Monte Carlo: error by plane",
        "needs": [planes_of],
        "settings": ["montecarlo"],
    },
    "montecarlo_convergence": {
        "title": "Monte Carlo: convergence",
        "needs": [planes_of],
        "settings": ["montecarlo"],
    },
    "montecarlo_map": {
        "title": "Monte Carlo: map of the error over the plane",
        "needs": [planes_of],
        "settings": ["montecarlo"],
    },
    "where_breakdown": {
        "title": "Where: error left by load, axis, joint and direction",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
    "where_joints": {
        "title": "Where: error of each joint against its angle",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
    "where_torque": {
        "title": "Where: torque left at each joint",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
    "gap_by_step": {
        "title": "Gap: error as effects are named",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
    "residual_field": {
        "title": "Gap: residual vectors before and after",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
    "parameter_shifts": {
        "title": "Gap: which parameters had been bent",
        "needs": ["discovery/analysis.json"],
        "settings": [],
    },
}
TABLES = {
    "table1_parameters": {
        "title": "Table I: parameters",
        "needs": [calibrations_of, "ingest/poses.parquet"],
        "settings": ["kcub_reading"],
    },
    "paper_against_ours": {
        "title": "Paper against ours",
        "needs": [
            calibrations_of,
            planes_of,
            "evaluation/holdout.json",
            "ingest/poses.parquet",
        ],
        "settings": ["kcub_reading", "montecarlo"],
    },
    "verdict": {
        "title": "Verdict: what is missing from the model",
        "needs": ["discovery/verdict.json"],
        "settings": [],
    },
}


rule figures:
    """Every figure and table of every campaign."""
    input:
        expand(result("figures/{figure}.svg"), campaign=SETTINGS.campaigns, figure=FIGURES),
        expand(result("tables/{table}.csv"), campaign=SETTINGS.campaigns, table=TABLES),


for name, picture in {**FIGURES, **TABLES}.items():

    rule:
        name:
            name
        input:
            campaign=raw("campaign.yaml"),
            results=needs(*picture["needs"]),
            code=code_of("stages.figures", f"figures.{name}"),
        output:
            **(figure_files if name in FIGURES else table_files)(name, picture["title"]),
        log:
            result(f"logs/{name}.log"),
        params:
            name=name,
            folder=campaign_folder,
            results=results_folder,
            out=lambda wildcards, output: os.path.dirname(output[0]),
            settings=sections_of("figures", *picture["settings"]),
        shell:
            "python -m pa10cal figures --figure {params.name} --campaign-dir {params.folder:q}"
            " --results-dir {params.results:q} --settings {params.settings:q}"
            " --out-dir {params.out:q} 2>&1 | tee {log:q} >&2"
