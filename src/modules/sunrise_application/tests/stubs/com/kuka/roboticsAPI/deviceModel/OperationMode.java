package com.kuka.roboticsAPI.deviceModel;

public enum OperationMode { T1, T2, AUT, CRR }
