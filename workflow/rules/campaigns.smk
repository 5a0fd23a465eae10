rule campaigns:
    """Every result of every campaign of the configuration."""
    input:
        expand(rules.calibrate.output, campaign=SETTINGS.campaigns),
        every(planes_of),
        expand(rules.discover.output.verdict, campaign=SETTINGS.campaigns),
        expand(rules.export.output.model, campaign=SETTINGS.campaigns),
        expand(rules.evaluate.output, campaign=SETTINGS.campaigns),
        rules.figures.input,
        expand(rules.page.output, campaign=SETTINGS.campaigns),
