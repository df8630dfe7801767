"""All words of the screens, one file a screen: constants and functions that take plain values.

``tests/app/test_words.py`` renders every one of them. Words of the checks come from
``model.validation``, those of running jobs from the jobs themselves.
"""
