package com.kuka.roboticsAPI.motionModel.controlModeModel;

import com.kuka.roboticsAPI.geometricModel.CartDOF;
import java.util.Arrays;

public class CartesianImpedanceControlMode implements IMotionControlMode {
    private final StringBuilder said = new StringBuilder("tool");

    public class Parameters {
        private final CartDOF dof;

        Parameters(CartDOF dof) { this.dof = dof; }

        public Parameters setStiffness(double v) {
            boolean turns = dof == CartDOF.ROT || dof == CartDOF.A || dof == CartDOF.B || dof == CartDOF.C;
            double max = turns ? 300 : 5000;
            if (!(v >= 0 && v <= max)) throw new IllegalArgumentException("stiffness " + v + " is not in 0.." + max);
            said.append(' ').append(dof).append(' ').append(v);
            return this;
        }

        public Parameters setDamping(double v) {
            if (!(v >= 0.1 && v <= 1)) throw new IllegalArgumentException("damping " + v + " is not in 0.1..1");
            said.append(" damping ").append(v);
            return this;
        }
    }

    public Parameters parametrize(CartDOF... dof) { return new Parameters(dof[0]); }

    public CartesianImpedanceControlMode setNullSpaceStiffness(double v) {
        if (!(v >= 0)) throw new IllegalArgumentException("null space stiffness " + v + " is negative");
        said.append(" null space ").append(v);
        return this;
    }

    public CartesianImpedanceControlMode setMaxPathDeviation(double x, double y, double z, double a, double b, double c) {
        said.append(" path ").append(Arrays.toString(new double[] {x, y, z, a, b, c}));
        return this;
    }

    public CartesianImpedanceControlMode setMaxControlForce(
            double x, double y, double z, double a, double b, double c, boolean stop) {
        said.append(" force ").append(Arrays.toString(new double[] {x, y, z, a, b, c})).append(stop);
        return this;
    }

    @Override
    public String toString() { return said.toString(); }
}
