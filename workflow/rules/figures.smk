# The pictures. A picture's entry says what the report calls it, the results it is drawn from, the
# settings it reads, and of which campaigns it is drawn: of those that all functions under `of` hold for.
FIGURES = {
    "health": {
        "title": "Health of the calibration",
        "needs": ["calibration/combined.json"],
        "settings": [],
        "of": [],
    },
    "fig4_test_path": {
        "title": "Fig. 4: test path",
        "needs": ["ingest/poses.parquet", "seed/base_frame.json"],
        "settings": [],
        "of": [by_papers_model],
    },
    "fig5_before_after": {
        "title": "Fig. 5: error before and after calibration",
        "needs": [calibrations_of, "ingest/poses.parquet"],
        "settings": [],
        "of": [by_papers_model],
    },
    "fig6_holdout": {
        "title": "Fig. 6: error at held-out points and loads",
        "needs": [EVALUATED, "evaluation/holdout.json"],
        "settings": [],
        "of": [by_papers_model, holds_out],
    },
    "residual_vectors": {
        "title": "Residual vectors in space",
        "needs": ["calibration/combined.json"],
        "settings": [],
        "of": [by_papers_model],
    },
    "parameter_uncertainty": {
        "title": "Parameters and their uncertainty",
        "needs": ["calibration/combined.json", "ingest/poses.parquet"],
        "settings": ["kcub_reading"],
        "of": [by_papers_model],
    },
    "l_curve": {
        "title": "L-curve of the tolerance terms",
        "needs": ["calibration/combined.json"],
        "settings": [],
        "of": [by_papers_model],
    },
    "montecarlo_planes": {
        "title": "Monte Carlo: error by plane",
        "needs": [planes_of],
        "settings": ["montecarlo"],
        "of": [by_papers_model],
    },
    "montecarlo_convergence": {
        "title": "Monte Carlo: convergence",
        "needs": [planes_of],
        "settings": ["montecarlo"],
        "of": [by_papers_model],
    },
    "montecarlo_map": {
        "title": "Monte Carlo: map of the error over the plane",
        "needs": [planes_of],
        "settings": ["montecarlo"],
        "of": [by_papers_model],
    },
    "held_out_errors": {
        "title": "Error of held-out poses",
        "needs": [EVALUATED, "evaluation/holdout.json"],
        "settings": [],
        "of": [by_general_model, holds_out],
    },
    "error_by_joint": {
        "title": "Error of each joint against its position",
        "needs": [
            EVALUATED,
            "evaluation/holdout.json",
            "calibration/combined.json",
            "ingest/poses.parquet",
        ],
        "settings": [],
        "of": [by_general_model, sees_positions],
    },
    "where_breakdown": {
        "title": "Where: error left by load, axis, joint and direction",
        "needs": [EVALUATED, "discovery/analysis.json"],
        "settings": ["evaluation"],
        "of": [seeks_effects],
    },
    "where_joints": {
        "title": "Where: error of each joint against its angle",
        "needs": [EVALUATED, "discovery/analysis.json"],
        "settings": ["evaluation"],
        "of": [seeks_effects],
    },
    "where_torque": {
        "title": "Where: torque left at each joint",
        "needs": [EVALUATED, "discovery/analysis.json"],
        "settings": ["evaluation"],
        "of": [judges_by_repeats],
    },
    "joint_error_maps": {
        "title": "Where: error maps of the joints",
        "needs": [EVALUATED, "discovery/verdict.json", "ingest/poses.parquet"],
        "settings": ["evaluation"],
        "of": [judges_by_blocks],
    },
    "gap_by_step": {
        "title": "Gap: error as effects are named",
        "needs": [EVALUATED, "discovery/analysis.json"],
        "settings": ["evaluation"],
        "of": [seeks_effects],
    },
    "residual_field": {
        "title": "Gap: residual vectors before and after",
        "needs": [gaps_of],
        "settings": ["evaluation"],
        "of": [],
    },
    "parameter_shifts": {
        "title": "Gap: which parameters had been bent",
        "needs": [EVALUATED, "discovery/analysis.json"],
        "settings": ["evaluation"],
        "of": [seeks_effects],
    },
}
TABLES = {
    "health_summary": {
        "title": "Health of the calibration",
        "needs": ["calibration/combined.json", general_of],
        "settings": [],
        "of": [],
    },
    "table1_parameters": {
        "title": "Table I: parameters",
        "needs": [calibrations_of, "ingest/poses.parquet"],
        "settings": ["kcub_reading"],
        "of": [by_papers_model],
    },
    "paper_against_ours": {
        "title": "Paper against ours",
        "needs": [calibrations_of, planes_of, "evaluation/holdout.json", "ingest/poses.parquet"],
        "settings": ["kcub_reading", "montecarlo"],
        "of": [by_papers_model],
    },
    "parameters_general": {
        "title": "Parameters of the general model",
        "needs": ["calibration/combined.json", general_of],
        "settings": [],
        "of": [],
    },
    "suspected_outliers": {
        "title": "Poses suspected_outliers",
        "needs": ["calibration/combined.json", general_of],
        "settings": [],
        "of": [],
    },
    "accuracy_general": {
        "title": "Accuracy of the general model",
        "needs": [accuracies_of],
        "settings": ["evaluation"],
        "of": [by_general_model],
    },
    "verdict": {
        "title": "Verdict: what is missing from the model",
        "needs": [EVALUATED, "discovery/verdict.json"],
        "settings": ["evaluation"],
        "of": [seeks_effects],
    },
}


rule figures:
    """Every figure and table of every campaign."""
    input:
        every(pictures_by_description),
        every(pictures_by_poses),


for name, picture in {**FIGURES, **TABLES}.items():

    rule:
        name:
            name
        input:
            campaign=raw("campaign.yaml"),
            arm=arm_of_campaign,
            results=needs(*picture["needs"]),
            code=code_of("commands.figures", f"figures.{name}"),
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
