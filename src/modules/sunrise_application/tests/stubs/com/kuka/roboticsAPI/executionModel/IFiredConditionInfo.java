package com.kuka.roboticsAPI.executionModel;

import com.kuka.roboticsAPI.conditionModel.ICondition;

public interface IFiredConditionInfo {
    ICondition getFiredCondition();
}
