def edited_unit(unit, given, model):
    return {}, []
