"""The vocabulary of effects that a model may lack, one small class a file.

A new effect is one more file here: its classes are found by `effect.every_effect`.
"""
