package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.executionModel.IFiredConditionInfo;

public interface IMotionContainer {
    boolean isFinished();

    void cancel();

    boolean hasError();

    String getErrorMessage();

    IFiredConditionInfo getFiredBreakConditionInfo();
}
