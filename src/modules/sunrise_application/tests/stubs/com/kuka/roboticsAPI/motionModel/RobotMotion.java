package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.conditionModel.ICondition;
import java.util.ArrayList;
import java.util.List;

public abstract class RobotMotion<T extends RobotMotion<T>> implements IMotion {
    protected final List<ICondition> conditions = new ArrayList<>();

    @SuppressWarnings("unchecked")
    public T breakWhen(ICondition c) {
        conditions.add(c);
        return (T) this;
    }
}
