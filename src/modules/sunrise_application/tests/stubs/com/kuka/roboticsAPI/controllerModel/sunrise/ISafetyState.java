package com.kuka.roboticsAPI.controllerModel.sunrise;

public interface ISafetyState {
    SunriseSafetyState.EnablingDeviceState getEnablingDeviceState();

    SunriseSafetyState.SafetyStopType getSafetyStopSignal();
}
