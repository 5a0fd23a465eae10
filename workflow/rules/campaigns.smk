rule campaigns:
    """Every result of every campaign of the configuration."""
    input:
        expand(rules.calibrate.output, campaign=EVERY),
        every(planes_of),
        expand(rules.discover.output, campaign=EVERY),
        expand(rules.export.output, campaign=EVERY),
        expand(rules.evaluate.output, campaign=EVERY),
        rules.figures.input,
        expand(rules.page.output, campaign=EVERY),
