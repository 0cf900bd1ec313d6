package com.kuka.roboticsAPI.conditionModel;

public interface ICondition {
    boolean fired();
}
