"""The vocabulary of effects that a model may lack, a module for those of one kind.

A new effect is a class in one of these modules, which `vocabulary.every_effect` finds.
"""
