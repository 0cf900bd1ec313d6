package com.kuka.roboticsAPI.applicationModel;

import com.kuka.roboticsAPI.motionModel.IErrorHandler;

public interface IApplicationControl {
    void registerMoveAsyncErrorHandler(IErrorHandler handler);
}
