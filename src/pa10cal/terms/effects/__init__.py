"""The vocabulary of effects that a model may lack, a module for those of one kind.

`effect.every_effect` finds every class in these modules; a new effect is a class in one of them.
"""
