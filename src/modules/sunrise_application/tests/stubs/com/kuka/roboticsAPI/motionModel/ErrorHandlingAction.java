package com.kuka.roboticsAPI.motionModel;

public enum ErrorHandlingAction { Ignore }
