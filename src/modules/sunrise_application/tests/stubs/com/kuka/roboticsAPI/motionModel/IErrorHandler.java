package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.deviceModel.Device;
import java.util.List;

public interface IErrorHandler {
    ErrorHandlingAction handleError(Device device, IMotionContainer failed, List<IMotionContainer> cancelled);
}
