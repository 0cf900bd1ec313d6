package com.kuka.roboticsAPI.controllerModel.sunrise;

public final class SunriseSafetyState {
    private SunriseSafetyState() { }

    public enum EnablingDeviceState { NONE, NORMAL, HANDGUIDING }

    public enum SafetyStopType { NOSTOP, STOP0, STOP1, STOP2 }
}
