"""Functions of the FMI standards that every FMU has to have, beside those that ours do something in."""

FINE = {
    2: ("SetDebugLogging", "EnterInitializationMode", "ExitInitializationMode", "Terminate"),
    3: ("ExitInitializationMode", "EnterStepMode", "Terminate"),
}
"""Those that change nothing here."""
_TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean", "String")
ABSENT = {
    2: (
        *(f"{way}{kind}" for way in ("Get", "Set") for kind in ("Integer", "Boolean", "String")),
        *("GetFMUstate", "SetFMUstate", "FreeFMUstate", "SerializedFMUstateSize", "SerializeFMUstate"),
        *("DeSerializeFMUstate", "GetDirectionalDerivative", "SetRealInputDerivatives", "GetRealOutputDerivatives"),
        *("CancelStep", "GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"),
    ),
    3: (
        *(f"{way}{kind}" for way in ("Get", "Set") for kind in (*_TYPES, "Binary", "Clock")),
        *("GetNumberOfVariableDependencies", "GetVariableDependencies", "SerializedFMUStateSize", "SerializeFMUState"),
        *("DeserializeFMUState", "GetDirectionalDerivative", "GetAdjointDerivative", "EnterConfigurationMode"),
        *("ExitConfigurationMode", "GetIntervalDecimal", "GetIntervalFraction", "GetShiftDecimal", "GetShiftFraction"),
        *("SetIntervalDecimal", "SetIntervalFraction", "SetShiftDecimal", "SetShiftFraction", "EnterEventMode"),
        *("EvaluateDiscreteStates", "UpdateDiscreteStates", "EnterContinuousTimeMode", "CompletedIntegratorStep"),
        *("SetTime", "SetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators"),
        *("GetContinuousStates", "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators"),
        *("GetNumberOfContinuousStates", "GetOutputDerivatives", "ActivateModelPartition"),
    ),
}
"""Those that answer with an error."""


def answers(version: int) -> str:
    """Return the C text of these functions."""
    lines = [f"ANSWER(fmi{version}{name}, OK)" for name in FINE[version]]
    return "\n".join([*lines, *(f"ANSWER(fmi{version}{name}, ERROR)" for name in ABSENT[version])])
