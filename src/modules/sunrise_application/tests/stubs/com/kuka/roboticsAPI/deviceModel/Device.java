package com.kuka.roboticsAPI.deviceModel;

public class Device { }
